# shellcheck shell=bash
# Sets up what clsss needs on this machine; sourced by demo.sh and test.sh, from the top folder.
# Installs only what is missing, says what it does and never asks: system packages with apt-get where there
# is one (through sudo if not root), Python packages into the folder .venv.

say() { printf 'setup: %s\n' "$*" >&2; }

# The first Python of 3.10 or later, $PYTHON before others.
find_python() {
    local candidate
    for candidate in ${PYTHON:+"$PYTHON"} python3 python3.13 python3.12 python3.11 python3.10; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    say "Python 3.10 or later is needed and was not found; install it, or name it in PYTHON"
    return 1
}

has_library() { "$1" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$2" 2>/dev/null; }

has_package() { dpkg -s "$1" >/dev/null 2>&1; }

# Debian packages that this machine lacks, one a line; a window's libraries only where there is a display.
missing_packages() {
    local python=$1 icd
    "$python" -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
    icd=$(find "${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}" -name '*.icd' 2>/dev/null | head -n 1 || true)
    [[ -n $icd ]] || echo pocl-opencl-icd
    has_library "$python" libOpenCL.so.1 || echo ocl-icd-libopencl1
    has_library "$python" libEGL.so.1 || echo libegl1
    has_library "$python" libGL.so.1 || echo libgl1
    has_package libgl1-mesa-dri || [[ -e /dev/nvidiactl ]] || echo libgl1-mesa-dri
    if [[ -n ${DISPLAY:-} ]]; then
        has_library "$python" libX11.so.6 || echo libx11-6
        has_library "$python" libXcursor.so.1 || echo libxcursor1
        has_library "$python" libXi.so.6 || echo libxi6
        has_library "$python" libXinerama.so.1 || echo libxinerama1
        has_library "$python" libXrandr.so.2 || echo libxrandr2
    fi
}

install_packages() {
    local as_root=()
    if [[ $(id -u) -ne 0 ]]; then
        if ! command -v sudo >/dev/null; then
            say "no sudo: as root, run: apt-get install $*"
            return 1
        fi
        as_root=(sudo)
        if [[ -n ${CI:-} || ! -t 0 ]]; then
            as_root=(sudo -n) # nobody is there to type a password
        fi
    fi
    say "apt-get install $*"
    "${as_root[@]}" apt-get update -qq >&2 || say "apt-get update failed; going on with the lists there are"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends "$@" >/dev/null
}

setup_system() {
    local missing
    mapfile -t missing < <(missing_packages "$1")
    if [[ ${#missing[@]} -eq 0 ]]; then
        return
    fi
    if ! command -v apt-get >/dev/null; then
        say "no apt-get here; if something is missing, install what Debian calls: ${missing[*]}"
        return
    fi
    install_packages "${missing[@]}"
}

# setup_venv PYTHON REQUIREMENT: the package, editable, in .venv; again only after pyproject.toml changed.
setup_venv() {
    local python=$1 requirement=$2 stamp
    stamp="$requirement $(cksum <pyproject.toml)"
    if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
        say "creating .venv with $("$python" --version)"
        "$python" -m venv --clear .venv
    fi
    if [[ $(cat .venv/clsss-setup 2>/dev/null) != "$stamp" ]]; then
        say "installing Python packages into .venv"
        .venv/bin/python -m pip install -q --disable-pip-version-check -e "$requirement" >&2
        printf '%s\n' "$stamp" >.venv/clsss-setup
    fi
}

# setup REQUIREMENT, such as . or '.[test]'
setup() {
    local python
    python=$(find_python)
    setup_system "$python"
    setup_venv "$python" "$1"
}
