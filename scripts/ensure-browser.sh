#!/usr/bin/env bash
# Installs Debian's Chromium for the tests of the page, where there is none and it can be; without it they are skipped.
set -euo pipefail
command -v chromium >/dev/null || command -v chromium-browser >/dev/null && exit 0
command -v apt-get >/dev/null || { echo "No Chromium: the tests of the page in a browser are skipped." >&2; exit 0; }
as_root=""
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || { echo "No Chromium: the tests of the page in a browser are skipped." >&2; exit 0; }
    as_root=sudo
fi
$as_root apt-get update -qq
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -qq -y --no-install-recommends chromium fonts-dejavu-core >/dev/null
