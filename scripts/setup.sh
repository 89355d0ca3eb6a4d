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
# and some distributions ship Python without venv: each candidate is run.
suits() {
    "$1" -c "import ensurepip, sys, venv; sys.exit('%d.%d' % sys.version_info[:2] not in '$2'.split())" \
        >/dev/null 2>&1
}

find_python() { # the versions that suit, then the names to look under
    local versions=$1 name path
    shift
    for name in "$@"; do
        while IFS= read -r path; do
            if suits "$path" "$versions"; then
                printf '%s\n' "$path"
                return
            fi
        done < <(type -ap "$name")
    done
    return 1
}

make_venv() {
    local python
    if python=$(find_python 3.11 python3.11 python3 python); then
        "$python" -m venv --clear .venv
    elif type -p uv >/dev/null; then
        echo "set-up: no Python 3.11 here; uv brings one"
        rm -rf .venv
        uv venv --no-config --python 3.11 --seed --quiet .venv ||
            stop "uv could not bring Python 3.11; its reason is above."
    elif python=$(find_python "3.12 3.13" python3.13 python3.12 python3 python); then
        can_build "$python"
        "$python" -m venv --clear .venv
    else
        stop "Python 3.11 to 3.13 with venv is needed; found: $(python3 -V 2>/dev/null || echo none)." \
            "Install it (Debian, Ubuntu: apt install python3 python3-venv; pyenv: pyenv install 3.11)" \
            "or install uv, which brings its own, and run the same command again."
    fi
}

can_build() {
    local headers='import os, sys, sysconfig
sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))'
    type -p g++ >/dev/null && "$1" -c "$headers" ||
        stop "PyBullet has no wheel for $("$1" -V); building it needs g++ and the Python headers." \
            "Install them (Debian, Ubuntu: apt install g++ python3-dev), or Python 3.11 or uv," \
            "for which there is a wheel, and run the same command again."
}

install() {
    .venv/bin/python -m pip install -qq --disable-pip-version-check --no-input \
        --no-compile --no-deps --require-hashes "$@"
}

# PyBullet publishes no wheel for another system, and pip would compile it for minutes.
system=$(uname -sm)
[ "$system" = "Linux x86_64" ] ||
    stop "Linux on x86_64 is needed (PyBullet has no prebuilt package elsewhere), this is $system."

supported='import pip, sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'
if ! .venv/bin/python -c "$supported" 2>/dev/null; then
    make_venv
fi

# Bytecode is left to the first import: compiling all of it takes half of the time.
echo "set-up: installing $(grep -c '^[a-z].*==' "$lock") packages of $lock, once; this takes a minute or two"
install --only-binary :all: -r "$lock" ||
    stop "pip could not install $lock (its reason is above; glibc 2.28 or newer and a package index are needed)."
if ! .venv/bin/python -c 'import pybullet' 2>/dev/null; then
    echo "set-up: building PyBullet for $(.venv/bin/python -V), once; this takes five to fifteen minutes"
    pin=$(mktemp)
    trap 'rm -f "$pin"' EXIT
    # Its lines of the lock without the marker that leaves it out on this Python.
    sed -n '/^pybullet==/,/^[a-z#].*/{/^pybullet==/s/ ;[^\\]*/ /;/^pybullet==\|--hash/p}' "$lock" >"$pin"
    install --no-binary pybullet -r "$pin" || stop "PyBullet could not be built; the reason is above."
    .venv/bin/python -c 'import pybullet; assert pybullet.connect(pybullet.DIRECT) >= 0' >/dev/null ||
        stop "PyBullet was built and does not start; the reason is above."
    echo "set-up: PyBullet works"
fi
.venv/bin/python -m pip install -qq --disable-pip-version-check --no-input \
    --no-deps --no-build-isolation --editable .
.venv/bin/python -m pip check --disable-pip-version-check
