# make demo and make test set everything up by themselves, in .venv, once.
.DEFAULT_GOAL := help
MINUTES ?= 1
.PHONY: help demo docs test test-all bench fuzz audit lint format types lock clean
BIN := .venv/bin
UV_LOCK := uv pip compile --no-config --quiet --no-header --generate-hashes \
	--universal --python-version 3.11 --group build $(UPGRADE) pyproject.toml

help:
	@echo "make demo    find an effect that a model lacks; writes a report"
	@echo "make docs    the pages as a site in site/, offline, links checked"
	@echo "make test    the checks of every change (ARGS='-k signals -x' for some)"
	@echo "make test-all  these and the slow ones: more cases, pages, browser, installation"
	@echo "make bench   measure every figure of README and docs on one commit; up to two"
	@echo "             hours (QUICK=1: ten minutes); an interrupted run continues"
	@echo "make fuzz    changed files for every reader, MINUTES=10 for each of them"
	@echo "make audit   known vulnerabilities of the locked packages; needs pip-audit, network"
	@echo "make lint    style, format, import directions"
	@echo "make format  put the code into the format that lint asks for"
	@echo "make types   static types (advice, not a gate)"
	@echo "make lock    pins again after a change in pyproject.toml (UPGRADE=--upgrade)"
	@echo "make clean   removes .venv and every cache"

demo: .venv/core.stamp
	@$(BIN)/modelgap demo $(ARGS)

# No network: fonts are the machine's, scripts lie in the package. A link that leads
# nowhere fails. Bare `python` is on the path, since a hook of the site imports our code.
docs: .venv/dev.stamp
	NO_MKDOCS_2_WARNING=1 OMP_NUM_THREADS=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "open site/index.html, or: $(BIN)/python -m http.server -b 127.0.0.1 -d site 8000"

# Files in their order: by number of tests, those that wait for a server came last, alone.
# Two processes for two cores: a third would load every module once more.
# One BLAS thread each: two workers with two threads each fight over two cores. Bytecode
# is kept even where the machine says otherwise: the tests start some forty programs, and
# without it each of them that loads Prefect compiles that anew, for five seconds.
test: CHOICE := -m "not long"
test test-all: .venv/dev.stamp
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
		$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder \
		$(CHOICE) $(ARGS)

# Alone on the machine: ratios bear other work, times do not.
bench: .venv/dev.stamp
	@$(BIN)/python benchmarks/bench.py $(if $(QUICK),--quick) $(ARGS)

# By the low road: it runs for as long as it is told to, beside other work.
fuzz: .venv/dev.stamp
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 nice -n 10 \
		$(BIN)/python -m tests.fuzz.run --minutes $(MINUTES) $(ARGS)

# The one command that asks the network.
audit:
	pip-audit --requirement requirements-dev.lock --require-hashes --disable-pip

lint: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo

format: .venv/dev.stamp
	$(BIN)/ruff check --fix-only --quiet .
	$(BIN)/ruff format .

types: .venv/dev.stamp
	$(BIN)/pyright

# The development lock takes every pin of the core lock over, so that what is tested
# is what a user gets.
lock:
	@command -v uv >/dev/null || { echo "make lock needs uv on the PATH"; exit 1; }
	$(UV_LOCK) --output-file requirements.lock >/dev/null
	$(UV_LOCK) --all-extras --constraint requirements.lock \
		--output-file requirements-dev.lock >/dev/null

clean:
	rm -rf .venv .pytest_cache .ruff_cache .import_linter_cache .hypothesis \
		build site *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: written last, so that an interrupted set-up is taken up again.
.venv/core.stamp: requirements.lock pyproject.toml scripts/setup.sh
	@scripts/setup.sh requirements.lock
	@touch $@

.venv/dev.stamp: requirements-dev.lock requirements.lock pyproject.toml scripts/setup.sh
	@scripts/setup.sh requirements-dev.lock
	@touch .venv/core.stamp $@
