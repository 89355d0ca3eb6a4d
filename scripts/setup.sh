#!/usr/bin/env bash
# Make .venv and fill it from a lock file: scripts/setup.sh requirements.lock
# Called by the Makefile, which remembers that it has been done.
set -euo pipefail
cd "$(dirname "$0")/.."
lock=$1

stop() {
    printf 'set-up: %s\n' "$@" >&2
    exit 1
}

# A name on the PATH may be a shim of a version manager that only prints a complaint,
# and some distributions ship Python without venv: so each candidate is asked.
suits() {
    "$1" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, 11))' \
        >/dev/null 2>&1
}

find_python() {
    local name path
    for name in python3.11 python3 python; do
        while IFS= read -r path; do
            if suits "$path"; then
                printf '%s\n' "$path"
                return
            fi
        done < <(type -ap "$name")
    done
    return 1
}

make_venv() {
    local python
    if python=$(find_python); then
        "$python" -m venv --clear .venv
    elif type -p uv >/dev/null; then
        echo "set-up: no Python 3.11 here; uv brings one"
        rm -rf .venv
        uv venv --no-config --python 3.11 --seed --quiet .venv ||
            stop "uv could not bring Python 3.11; its reason is above."
    else
        stop "Python 3.11 with venv is needed; found: $(python3 -V 2>/dev/null || echo none)." \
            "Install it (Debian, Ubuntu: apt install python3.11 python3.11-venv; pyenv: pyenv install 3.11)" \
            "or install uv, which brings its own, and run the same command again."
    fi
}

# PyBullet publishes no wheel for another system, and pip would compile it for minutes.
system=$(uname -sm)
[ "$system" = "Linux x86_64" ] ||
    stop "Linux on x86_64 is needed (PyBullet has no prebuilt package elsewhere), this is $system."

if ! .venv/bin/python -c 'import pip, sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
    make_venv
fi

# Bytecode is left to the first import: compiling all of it takes half of the time.
echo "set-up: installing $(grep -c '^[a-z].*==' "$lock") packages of $lock, once; this takes a minute or two"
.venv/bin/python -m pip install -qq --disable-pip-version-check --no-input \
    --no-compile --no-deps --only-binary :all: --require-hashes -r "$lock" ||
    stop "pip could not install $lock (its reason is above; glibc 2.28 or newer and a package index are needed)."
.venv/bin/python -m pip install -qq --disable-pip-version-check --no-input \
    --no-deps --no-build-isolation --editable .
.venv/bin/python -m pip check --disable-pip-version-check
