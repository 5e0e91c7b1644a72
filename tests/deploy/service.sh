#!/usr/bin/env bash
# The service under a real systemd: a Debian 12 container that boots it.
#   sudo tests/deploy/service.sh [FOLDER]   FOLDER (else /var/tmp/companion-service) is kept, for the next time
# install.sh from this checkout, enable, boot: active beside a simulated vehicle that stands on its pad; kill -9 and
# SIGSTOP: restarted, nothing armed; the preflight check leaves its devices alone; a pilot's flights, by pilot.py:
# devices that come late, landings, kill -9 and SIGSTOP in each phase; removed, nothing but logs and settings is left.
# PYTHON: the Python whose pip fetches the wheels (else python3). FLIGHTS: the parts to fly (else "land kill stop").
# FLY_WITH: words put before the command of each part, which flies in real time for two to three minutes.
# Exit codes: 0 all well, 1 something is not, 77 skipped, with one line that says why.
set -euo pipefail
readonly SOURCE="$(cd "$(dirname "$0")/../.." && pwd)"
readonly FOLDER="$(realpath -m "${1:-/var/tmp/companion-service}")"
readonly ROOT="$FOLDER/root"
readonly PYTHON="${PYTHON:-python3}"
# the mirror of this machine, unless told
readonly MIRROR="${MIRROR:-$(sed -n "s/^deb[^h]*\(http[^ ]*\).*/\1/p; s/^URIs: *//p" /etc/apt/sources.list /etc/apt/sources.list.d/* 2>/dev/null | head -n 1)}"
readonly FLIGHTS="${FLIGHTS-land kill stop}"
readonly PATIENCE_S=120
read -ra fly_with <<<"${FLY_WITH:-}"
container="" leader=""

# shellcheck source=tests/deploy/container.bash
. "$SOURCE/tests/deploy/container.bash"

skip() { echo "service: skipped: $*"; exit 77; }
fail() { echo "service: failed: $*"; exit 1; }
step() { echo "service: $* ($SECONDS s)"; }

[ "$(id -u)" -eq 0 ] || skip "needs root, for a container"
for program in debootstrap systemd-nspawn nsenter; do
    command -v "$program" >/dev/null || skip "no $program; apt install debootstrap systemd-container"
done
"$PYTHON" -m pip --version >/dev/null 2>&1 || skip "$PYTHON has no pip"

# a part of pilot.py
fly() {
    enter
    "${fly_with[@]}" "${entering[@]}" PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 \
        sh -c 'cd /src && exec /opt/companion/current/.venv/bin/python -m tests.deploy.pilot "$1"' sh "$1"
}

install -d "$FOLDER"
if [ ! -x "$ROOT/usr/bin/systemctl" ]; then
    step "a Debian 12 root"
    debootstrap --include=systemd,systemd-sysv,dbus,python3,python3-venv,procps bookworm "$ROOT" "$MIRROR" \
        >"$FOLDER/debootstrap.log" 2>&1 \
        || skip "debootstrap from $MIRROR: $(tail -n 1 "$FOLDER/debootstrap.log")"
fi
step "wheels"
mapfile -t needed < <("$PYTHON" -c '
import sys, tomllib
with open(sys.argv[1], "rb") as file:
    print(*tomllib.load(file)["project"]["dependencies"], sep="\n")' "$SOURCE/pyproject.toml")
platforms=()
for glibc in 17 24 27 28 31 34; do platforms+=(--platform "manylinux_2_${glibc}_$(uname -m)"); done
"$PYTHON" -m pip download --quiet --dest "$ROOT/wheels" "${platforms[@]}" \
    --platform "manylinux2014_$(uname -m)" --python-version 3.11 --only-binary=:all: \
    -c "$SOURCE/constraints.txt" hatchling pip simplejpeg gpiozero "${needed[@]}" 2>"$FOLDER/pip.log" \
    || fail "the wheels: $(grep -m 1 ERROR "$FOLDER/pip.log")"
rm -rf "$ROOT/src"
install -d "$ROOT/src"
for name in companion sitl calibration configs docs systemd tests benchmarks experiments pyproject.toml constraints.txt README.md CHANGELOG.md \
    LICENSE; do
    cp -r "$SOURCE/$name" "$ROOT/src/"
done

step "boot"
boot || skip "systemd does not boot in a container here: $(tail -n 1 "$FOLDER/boot.log")"

step "install.sh, enable"
list_files >"$FOLDER/before"
inside bash /src/systemd/install.sh >"$FOLDER/install.log" 2>&1 || fail "install.sh: $(tail -n 1 "$FOLDER/install.log")"
inside systemctl enable --quiet companion
inside systemd-analyze verify /etc/systemd/system/companion.service || fail "systemd-analyze verify"
exposure="$(inside systemd-analyze security companion.service --no-pager | tail -n 1 | grep -o '[0-9]\+\.[0-9]')"
step "systemd-analyze: verify clean, security $exposure (bar: 2.0)"
[ "$(echo "$exposure" | tr -d .)" -le 20 ] || fail "security $exposure"

# a vehicle that stands on its pad, with all its devices; the settings that lead there become the service's
cat >"$ROOT/etc/systemd/system/vehicle.service" <<'END'
[Unit]
Before=companion.service
[Service]
User=companion
RuntimeDirectory=vehicle
ExecStart=/opt/companion/current/.venv/bin/python -m sitl.cli hand-held --motion still --folder /run/vehicle --settings /run/vehicle/companion.yaml
WorkingDirectory=/run/vehicle
Environment=PYTHONUNBUFFERED=1 OPENBLAS_NUM_THREADS=1
ExecStartPost=/bin/sh -c 'until [ -s /run/vehicle/companion.yaml ]; do sleep 0.2; done'
[Install]
WantedBy=multi-user.target
END
ln -sf /run/vehicle/companion.yaml "$ROOT/etc/companion/companion.yaml"
inside systemctl daemon-reload
inside systemctl enable --quiet vehicle

step "boot again"
shut_down
boot || fail "it does not boot with the service enabled: $(tail -n 1 "$FOLDER/boot.log")"
until_well systemctl is-active companion || fail "not active: $(inside systemctl status companion | tail -n 3)"
until_well sh -c "systemctl show companion --property=StatusText --value | grep ." || fail "no status"
step "active: $(inside systemctl show companion --property=StatusText --value)"

for signal in KILL STOP; do
    before="$(main_process)"
    inside kill -s "$signal" "$before"
    active_again "$before" || fail "not active again after SIG$signal"
    step "SIG$signal: restarted; $(inside systemctl show companion --property=StatusText --value)"
done
# armed or asked for, it would say so in its own words
! inside journalctl --unit companion --no-pager | grep -E 'arming|taking off' || fail "it asked for a flight"

step "companion check"
code=0
inside companion check --config /etc/companion/companion.yaml --json - >"$FOLDER/check.json" || code=$?
"$PYTHON" - "$FOLDER/check.json" "$code" <<'END' || fail "companion check ends with $code"
import json, sys
told = {(f["group"], f["name"]): f for f in json.load(open(sys.argv[1]))["findings"]}
service = told["computer", "service"]
print(f"  {service['state']:8} service: {service['detail']}")
left = {group for (group, _), f in told.items() if "the service is running" in f["detail"]}
wrong = service["state"] != "ok" or not {"camera", "IMU", "GPS", "range", "link"} <= left or sys.argv[2] != "0"
sys.exit(f"expected an enabled service whose devices are left alone, found {service}, {sorted(left)}" if wrong else 0)
END

if [ -n "$FLIGHTS" ]; then
    step "boot a third time, without devices"
    rm "$ROOT/etc/companion/companion.yaml"
    inside systemctl disable --quiet vehicle
    inside sh -c 'cd /src && /opt/companion/current/.venv/bin/python -m tests.deploy.pilot settings' \
        >"$ROOT/etc/companion/companion.yaml" || fail "the settings"
    shut_down
    boot || fail "it does not boot without devices: $(tail -n 1 "$FOLDER/boot.log")"
    until_well systemctl is-active companion || fail "not active: $(inside systemctl status companion | tail -n 3)"
fi
for part in $FLIGHTS; do
    step "a pilot flies: $part"
    fly "$part" || fail "a pilot flies: $part: $(inside journalctl --unit companion --no-pager | tail -n 20)"
done

step "install.sh --remove"
inside bash /src/systemd/install.sh --remove >"$FOLDER/install.log" 2>&1 || fail "remove: $(tail -n 1 "$FOLDER/install.log")"
left="$(inside sh -c 'ls -d /opt/companion /etc/systemd/system/companion.service /usr/local/bin/companion* 2>/dev/null; pgrep -u companion -f companion.cli' || true)"
[ -z "$left" ] || fail "removed, and still there: $left"
[ -e "$ROOT/var/lib/companion" ] && [ -e "$ROOT/etc/companion/companion.yaml" -o -L "$ROOT/etc/companion/companion.yaml" ] || fail "logs or settings are gone"
# `vehicle` and the backups of passwd and group are not ours
list_files >"$FOLDER/after"
left="$(comm -13 "$FOLDER/before" "$FOLDER/after" | grep -v -e '^/etc/companion\(/\|$\)' -e '^/var/lib/companion\(/\|$\)' \
    -e '/vehicle.service$' -e '^/etc/\(passwd\|group\|shadow\|gshadow\)-$' -e '^/var/lib/\(systemd\|apt\)/' || true)"
[ -z "$left" ] || fail "removed, and still there: $left"
step "install, boot, restarts, check, flights and removal are well"
