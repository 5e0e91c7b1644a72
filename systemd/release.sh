#!/usr/bin/env bash
# Builds the releases: a bundle for each architecture that installs without a network on Debian 12 and 13.
#   systemd/release.sh FOLDER [ARCHITECTURE ...]   else aarch64 and x86_64; PYTHON: the Python with pip (else python3)
# Each holds our wheel, the wheel of every dependency for both Pythons, pip, the installer, documents and checksums.
set -euo pipefail
readonly HERE="$(cd "$(dirname "$0")" && pwd)"
readonly SOURCE="$(dirname "$HERE")"
readonly PYTHON="${PYTHON:-python3}"
readonly PYTHONS=(3.11 3.13) # Debian 12, 13
readonly DOCUMENTS=(systemd/README.md CHANGELOG.md LICENSE constraints.txt)

fail() { echo "release: $*" >&2; exit 1; }
pip() {
    "$PYTHON" -m pip "$@" --quiet --disable-pip-version-check >"$work/log" 2>&1 \
        || fail "$(grep -m 1 -E "^(ERROR|[A-Za-z]*Error)" "$work/log" || tail -n 1 "$work/log")"
}

[ $# -ge 1 ] || fail "expected FOLDER [ARCHITECTURE ...]"
out="$(realpath -m "$1")"
shift
architectures=("$@")
[ $# -gt 0 ] || architectures=(aarch64 x86_64)
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
install -d "$out" "$work/source"

# from a copy: a build leaves files behind
for name in companion sitl calibration configs pyproject.toml README.md LICENSE; do
    cp -r "$SOURCE/$name" "$work/source/"
done
find "$work/source" -name __pycache__ -prune -exec rm -rf {} +
pip wheel --no-deps --wheel-dir "$work/own" "$work/source"
own="$(echo "$work/own"/*.whl)"
version="$(basename "$own" | cut -d- -f2)"
revision="$(git -C "$SOURCE" describe --always --dirty --abbrev=12 --exclude='*' 2>/dev/null || true)"
# the same files at the same revision give the same bundle
stamp="$(git -C "$SOURCE" log -1 --format=%ct 2>/dev/null || echo 0)"

for architecture in "${architectures[@]}"; do
    bundle="companion-$version-$architecture"
    folder="$work/$bundle"
    install -d "$folder/wheels"
    platforms=(--platform "manylinux2014_$architecture")
    # up to Debian 12's C library
    for glibc in $(seq 17 36); do platforms+=(--platform "manylinux_2_${glibc}_$architecture"); done
    for python in "${PYTHONS[@]}"; do
        pip download --dest "$folder/wheels" "${platforms[@]}" --python-version "$python" --only-binary=:all: \
            -c "$SOURCE/constraints.txt" "${own}[release]" pip
        # pip judges markers by the Python that runs it, so these are named here: lgpio has no wheels from 3.13 on,
        # and the other none for a machine without pins
        case "$python $architecture" in
            3.11*) lgpio=lgpio ;;
            *aarch64) lgpio=adafruit-lgpio ;;
            *) lgpio="" ;;
        esac
        [ -z "$lgpio" ] || pip download --no-deps --dest "$folder/wheels" "${platforms[@]}" \
            --python-version "$python" --only-binary=:all: -c "$SOURCE/constraints.txt" "$lgpio"
        echo "cp${python/./}" >>"$folder/PYTHONS"
    done
    for name in "${DOCUMENTS[@]}" docs; do cp -r "$SOURCE/$name" "$folder/"; done
    find "$folder/docs" \( -name __pycache__ -o -name '*.py' \) -prune -exec rm -rf {} +
    cp "$HERE/install.sh" "$HERE/versions.sh" "$HERE/companion-rollback" "$HERE/companion.service" "$folder/"
    echo "$architecture" >"$folder/ARCHITECTURE"
    echo "$revision" >"$folder/REVISION"
    (cd "$folder" && find . -type f ! -name SHA256SUMS -print0 | sort -z | xargs -0 sha256sum >SHA256SUMS)
    # wheels are compressed already
    tar --create --file "$out/$bundle.tar" --directory "$work" --sort=name --mtime="@$stamp" --owner=0 --group=0 \
        --numeric-owner --mode=u=rwX,go=rX "$bundle"
    (cd "$out" && sha256sum "$bundle.tar" >"$bundle.tar.sha256")
    rm -rf "$folder"
    echo "release: $out/$bundle.tar, $(($(stat --format=%s "$out/$bundle.tar") / 1000000)) MB"
done
