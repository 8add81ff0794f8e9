#!/usr/bin/env bash
# Makes the virtual environment in $1. Installs Debian's own packages where they are missing: a bare Debian 12 has
# neither Python nor venv, nor the OpenMP runtime that pinocchio's wheel links against.
set -euo pipefail
venv=$1

usable() { "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

find_python() {
    for candidate in python3.11 python3 python3.12 python3.13; do
        if command -v "$candidate" >/dev/null && usable "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    return 1
}

has_library() { PATH="$PATH:/sbin:/usr/sbin" ldconfig -p | grep -q "$1"; }

missing=()
find_python >/dev/null || missing+=(python3 python3-venv ca-certificates)
has_library libgomp.so.1 || missing+=(libgomp1)

if [ "${#missing[@]}" -gt 0 ]; then
    command -v apt-get >/dev/null || { echo "workgauge needs: ${missing[*]} (Debian's names); install them and run make again." >&2; exit 2; }
    as_root=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || { echo "Run 'apt-get install ${missing[*]}' as root, then make again." >&2; exit 2; }
        as_root=sudo
    fi
    $as_root apt-get update -qq
    DEBIAN_FRONTEND=noninteractive $as_root apt-get install -qq -y --no-install-recommends "${missing[@]}"
fi
python=$(find_python) || { echo "No Python 3.11 or newer with venv after installing Debian's." >&2; exit 2; }
"$python" -m venv "$venv"
