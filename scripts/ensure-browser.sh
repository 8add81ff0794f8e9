#!/usr/bin/env bash
# Installs Debian's Chromium for the tests of the page, where there is none and it can be. Without one those tests are
# skipped, and the end of the test run says so; everything below the browser is tested all the same.
set -euo pipefail
command -v chromium >/dev/null || command -v chromium-browser >/dev/null && exit 0

without() { echo "*** NO CHROMIUM ($1): the page is not tested in a browser ***" >&2; exit 0; }

command -v apt-get >/dev/null || without "no apt-get to install it with; install it and run make again"
as_root=""
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || without "run 'apt-get install chromium' as root, then make again"
    as_root=sudo
fi
$as_root apt-get update -qq || without "apt-get update failed"
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -qq -y --no-install-recommends chromium fonts-dejavu-core \
    >/dev/null || without "apt-get could not install it"
