#!/usr/bin/env bash
# The check of a GPU on a machine without network, from the parts that `make gpu-bundle` writes:
#   bash run.sh PARTS OUT [FLAGS]
# PARTS is the folder with all parts, into which everything is unpacked; OUT receives the findings; FLAGS are those of
# `python -m tests.gpu`. A second call skips the unpacking. PYTHON names another Python than python3.12.
set -euo pipefail
parts=$(realpath "$1") out=$(realpath -m "$2")
shift 2
python=${PYTHON:-python3.12}
site=$parts/site

if [ ! -d "$site" ]; then
    cat "$parts"/part*/bundle.* | tar xf - -C "$parts"
    wheels=$parts/bundle/wheels
    # pip runs from its own wheel: some images have none.
    pip=("$wheels"/pip-*.whl)
    rm -rf "$site.new"
    "$python" "${pip[0]}/pip" install --quiet --root-user-action ignore --no-compile --no-index \
        --find-links "$wheels" --target "$site.new" 'dappo-batch[gpu]' pytest
    mv "$site.new" "$site"
fi
# Vulkan's loader, where the system has none.
if ! PATH=$PATH:/sbin ldconfig -p | grep 'libvulkan\.so\.1' >/dev/null; then
    for deb in "$parts"/bundle/debs/*.deb; do dpkg -x "$deb" "$parts/system"; done
    export LD_LIBRARY_PATH=$parts/system/usr/lib/x86_64-linux-gnu:${LD_LIBRARY_PATH:-}
fi
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp} PYTHONPATH=$site
cd "$parts/bundle"
exec "$python" -m tests.gpu --out "$out" "$@"
