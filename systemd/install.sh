#!/usr/bin/env bash
# Installs the companion as a systemd service on 64-bit Raspberry Pi OS (Debian 12 or 13).
#   sudo systemd/install.sh            install or upgrade; settings in /etc/companion are kept
#   sudo systemd/install.sh --remove   stop and remove; settings and flight logs are kept
set -euo pipefail

readonly PREFIX=/opt/companion
readonly SETTINGS=/etc/companion
readonly UNIT=/etc/systemd/system/companion.service
readonly SOURCE="$(cd "$(dirname "$0")/.." && pwd)"

# for the calibrations and the check, by hand
readonly PROGRAMS=(companion calibrate-camera calibrate-magnetometer calibrate-mount)

fail() { echo "install.sh: $*" >&2; exit 2; }

[ "$(id -u)" -eq 0 ] || fail "needs root; run: sudo $0"
command -v systemctl >/dev/null || fail "no systemctl here; expected a system that runs systemd"

if [ "${1:-}" = "--remove" ]; then
    systemctl disable --now companion.service 2>/dev/null || true
    rm -f "$UNIT"
    rm -rf "$PREFIX"
    for program in "${PROGRAMS[@]}"; do
        rm -f "/usr/local/bin/$program"
    done
    systemctl daemon-reload
    echo "removed; settings stay in $SETTINGS, flight logs in /var/lib/companion"
    exit 0
fi
[ $# -eq 0 ] || fail "unknown argument '$1'; expected none or --remove"

python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "needs Python 3.11 or newer"
python3 -c 'import venv, ensurepip' 2>/dev/null || fail "needs python3-venv; run: apt install python3-venv"

getent group companion >/dev/null || groupadd --system companion
id companion >/dev/null 2>&1 || useradd --system --gid companion --home-dir /var/lib/companion \
    --no-create-home --shell /usr/sbin/nologin companion
# the unit names these; a system without a camera or GPIO lacks some of them
for group in dialout i2c spi video gpio; do
    getent group "$group" >/dev/null || groupadd --system "$group"
done

install -d "$PREFIX" "$SETTINGS"
for folder in companion sitl calibration configs; do
    rm -rf "${PREFIX:?}/$folder"
    cp -r "$SOURCE/$folder" "$PREFIX/"
done
cp "$SOURCE/pyproject.toml" "$SOURCE/constraints.txt" "$SOURCE/README.md" "$SOURCE/LICENSE" "$PREFIX/"
# which stands in each flight's log
git -C "$SOURCE" describe --always --dirty --abbrev=12 --exclude='*' >"$PREFIX/REVISION" 2>/dev/null || true
# system site packages: picamera2 and lgpio come from the distribution
python3 -m venv --system-site-packages "$PREFIX/.venv"
"$PREFIX/.venv/bin/python" -m pip install --quiet -c "$PREFIX/constraints.txt" -e "$PREFIX"
[ -e "$SETTINGS/companion.yaml" ] || install -m 0644 "$SOURCE/configs/companion.yaml" "$SETTINGS/companion.yaml"
chown -R root:companion "$SETTINGS"

for program in "${PROGRAMS[@]}"; do
    ln -sf "$PREFIX/.venv/bin/$program" "/usr/local/bin/$program"
done

install -m 0644 "$SOURCE/systemd/companion.service" "$UNIT"
systemctl daemon-reload
echo "installed; look through $SETTINGS/companion.yaml, then: systemctl enable --now companion"
echo "it stands by and flies nothing unasked: companion status, companion order land; see docs/service.md"
echo "root and the group companion may ask it: usermod -aG companion ${SUDO_USER:-USER}, and a new login"
