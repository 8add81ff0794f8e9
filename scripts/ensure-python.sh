#!/usr/bin/env bash
# Makes the virtual environment in $1 with Python 3.11 or newer; installs Debian's own packages for it where
# they are missing (a bare Debian 12 has neither Python nor venv).
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

if ! python=$(find_python); then
    if ! command -v apt-get >/dev/null; then
        echo "workgauge needs Python 3.11 or newer with venv; install it and run make again." >&2
        exit 2
    fi
    as_root=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || { echo "Run 'apt-get install python3 python3-venv' as root, then make again." >&2; exit 2; }
        as_root=sudo
    fi
    $as_root apt-get update -qq
    DEBIAN_FRONTEND=noninteractive $as_root apt-get install -qq -y --no-install-recommends python3 python3-venv ca-certificates
    python=$(find_python) || { echo "No Python 3.11 or newer with venv after installing Debian's." >&2; exit 2; }
fi
"$python" -m venv "$venv"
