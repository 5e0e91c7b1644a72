#!/usr/bin/env bash
# The release on arm64, on a machine that is none: installed without a network, imported, --version, check and a
# flight in a Debian 12 root.
#   sudo tests/deploy/arm64.sh [FOLDER]     FOLDER (else /var/tmp/companion-arm64) is kept, for the next time
# qemu-user runs each program; nothing has to be registered with the kernel. PYTHON: the Python whose pip fetches
# the wheels (else python3). BUNDLE: a release that is built already. LONGEST_S: how long a program may take (else
# 3600: on a machine that has other work the flight takes ten times as long). Exit codes: 0 all well, 1 something is
# not, 77 skipped, with one line that says why.
set -euo pipefail
readonly SOURCE="$(cd "$(dirname "$0")/../.." && pwd)"
readonly FOLDER="$(realpath -m "${1:-/var/tmp/companion-arm64}")"
readonly ROOT="$FOLDER/root"
readonly PYTHON="${PYTHON:-python3}"
readonly LONGEST_S="${LONGEST_S:-3600}"
# the mirror of this machine, unless told
readonly MIRROR="${MIRROR:-$(sed -n "s/^deb[^h]*\(http[^ ]*\).*/\1/p; s/^URIs: *//p" /etc/apt/sources.list /etc/apt/sources.list.d/* 2>/dev/null | head -n 1)}"

PROGRAM=/usr/bin/python3.11

skip() { echo "arm64: skipped: $*"; exit 77; }
fail() { echo "arm64: failed: $*"; exit 1; }
step() { echo "arm64: $* ($SECONDS s)"; }

[ "$(id -u)" -eq 0 ] || skip "needs root, for debootstrap and chroot"
for program in debootstrap qemu-aarch64-static dpkg-deb unshare; do
    command -v "$program" >/dev/null || skip "no $program; apt install debootstrap qemu-user-static"
done
"$PYTHON" -m pip --version >/dev/null 2>&1 || skip "$PYTHON has no pip"

# in namespaces of its own: /proc and /dev vanish with it, and there is no network
run() {
    timeout --kill-after=10 "$LONGEST_S" unshare --mount --net --propagation private bash -euc '
        mount -t proc proc "$0/proc"; mount --bind /dev "$0/dev"
        ip link set lo up 2>/dev/null || true
        exec chroot "$0" /usr/bin/qemu-aarch64-static -E OPENBLAS_NUM_THREADS=1 -E HOME=/root "$@"' \
        "$ROOT" "$PROGRAM" "$@"
}

if [ ! -x "$ROOT/usr/bin/python3.11" ]; then
    step "a Debian 12 root"
    debootstrap --arch=arm64 --foreign --variant=minbase --include=python3 bookworm "$ROOT" "$MIRROR" \
        >"$FOLDER.log" 2>&1 || skip "debootstrap from $MIRROR: $(tail -n 1 "$FOLDER.log")"
    for package in "$ROOT"/var/cache/apt/archives/*.deb; do
        # not in place of the links into /usr
        dpkg-deb --fsys-tarfile "$package" | tar --extract --keep-directory-symlink --directory "$ROOT"
    done
fi
install -m 0755 "$(command -v qemu-aarch64-static)" "$ROOT/usr/bin/qemu-aarch64-static"
[ "$(run -c 'import platform; print(platform.machine())')" = aarch64 ] || fail "the root's Python does not run"

if [ -n "${BUNDLE:-}" ]; then
    cp "$BUNDLE" "$FOLDER/"
else
    step "the release"
    env PYTHON="$PYTHON" "$SOURCE/systemd/release.sh" "$FOLDER" aarch64 || fail "systemd/release.sh"
fi
install -d "$ROOT/opt"
rm -rf "$ROOT/opt/companion" "$ROOT"/opt/companion-*
tar --extract --file "$FOLDER"/companion-*-aarch64.tar --directory "$ROOT/opt"
release="/opt/$(basename "$ROOT"/opt/companion-*-aarch64)"
# as install.sh does; the script itself would need every program of the root to run by itself, and systemd
step "install, without a network"
run -m venv --without-pip /opt/companion || fail "the virtual environment"
PROGRAM=/opt/companion/bin/python
wheels=("$ROOT$release"/wheels/pip-*.whl "$ROOT$release"/wheels/companion_landing-*.whl)
mapfile -t lgpio < <(compgen -G "$ROOT$release/wheels/*lgpio-*-cp311-*.whl" || true)
run "${wheels[0]#"$ROOT"}/pip" install --quiet --disable-pip-version-check --no-index --find-links "$release/wheels" \
    --no-cache-dir --root-user-action ignore -c "$release/constraints.txt" "${wheels[1]#"$ROOT"}[release]" \
    "${lgpio[@]#"$ROOT"}" 2>"$FOLDER.log" || fail "the release does not install: $(tail -n 1 "$FOLDER.log")"
# two metres to the pad, four down: a whole flight, and half of the shipped ones' time
cp "$SOURCE/benchmarks/service/near.yaml" "$ROOT/opt/companion/"

step "import"
run -c 'import cv2, mavsdk, numpy, osqp, pymavlink, scipy; import companion.app.app, sitl.run.in_process' \
    || fail "an import"

step "companion --version"
run -m companion.cli --version || fail "companion --version"

step "companion check"
code=0
run -m companion.cli check --json - >"$FOLDER/check.json" || code=$?
[ "$code" -eq 1 ] || fail "companion check ends with $code, expected 1: it has no devices here"
"$PYTHON" - "$FOLDER/check.json" <<'END' || fail "companion check"
import json, sys
fails = [f for f in json.load(open(sys.argv[1]))["findings"] if f["state"] == "fail"]
for f in fails:
    print(f"  fail  {f['group']}: {f['name']}: {f['detail']}")
absent = {"camera", "IMU", "GPS", "range", "link"}
sys.exit({f["group"] for f in fails} != absent and "expected these alone to fail: " + ", ".join(sorted(absent)))
END

step "companion --sitl --fast"
code=0
run -m companion.cli --sitl --fast --scenario /opt/companion/near.yaml --seed 0 --no-ui --json /opt/flight.json || code=$?
[ "$code" -ne 124 ] || fail "the flight did not end within $LONGEST_S s"
[ "$code" -eq 0 ] || fail "the flight ends with $code"
rate="$("$PYTHON" -c 'import json, sys; print(json.load(open(sys.argv[1]))["sim"]["real_time_factor"])' "$ROOT/opt/flight.json")"
step "landed: $rate virtual seconds a second"
step "install, import, --version, check and flight are well"
