#!/usr/bin/env bash
# Installs the companion as a systemd service on 64-bit Raspberry Pi OS (Debian 12 or 13).
#   sudo ./install.sh            install, upgrade or downgrade to the version of this release: no network is used
#   sudo ./install.sh --remove   stop and remove; settings, keys and flight logs are kept
#   sudo systemd/install.sh      the same from a checkout: builds a wheel, and fetches what it needs
# The new version is laid beside the one in use, and only once it is whole are the two switched, the service restarted
# and checked; if it is not well, the one before is put back. Nothing in /etc/companion is changed, nor who owns it.
# Exit codes: 0 installed or removed, 1 taken back (or a removal interrupted), 2 nothing was changed, with one line that says why.
set -euo pipefail
readonly HERE="$(cd "$(dirname "$(readlink -f "$0")")" && pwd)"
# shellcheck source=systemd/versions.sh
. "$HERE/versions.sh"
readonly DISTRIBUTION=companion_landing
readonly NEEDED_MB=1500
# low priority: a service that stands by keeps its time
gently=(nice -n 10)
work=""

need_root
if [ "${1:-}" = "--remove" ]; then
    adopt_old_layout
    reason="$(why_no_restart)"
    case "$reason" in
        "" | *"does not answer"*) ;;
        *) fail "$reason: nothing was removed; expected a vehicle on the ground, disarmed" ;;
    esac
    trap '' HUP
    trap 'echo "$(basename "$0"): the removal was interrupted; expected it again: ${AS_ROOT}$0 --remove" >&2; exit 1' INT TERM
    say "removing: may take minutes on a Raspberry Pi"
    systemctl disable --now companion.service 2>/dev/null || true
    # first what others go by: interrupted later on, nothing leads to half a version, or takes it for a whole one
    for program in "${PROGRAMS[@]}" companion-rollback; do
        rm -f "$PROGRAMS_FOLDER/$program"
    done
    rm -f "$UNIT" "$CURRENT" "$PREVIOUS" "$VERSIONS"/*/COMPLETE
    systemctl daemon-reload
    rm -rf "$PREFIX"
    say "removed; settings stay in $SETTINGS, flight logs in $FLIGHTS, and what 'companion setup' has changed"
    exit 0
fi
[ $# -eq 0 ] || fail "unknown argument '$1'; expected none or --remove"

command -v python3 >/dev/null || fail "needs Python 3.11 or newer; run: apt install python3"
python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "needs Python 3.11 or newer"
python3 -c 'import venv' 2>/dev/null || fail "needs Python's venv; run: apt install python3-venv"
readonly TAG="$(python3 -c 'import sys; print(f"cp{sys.version_info[0]}{sys.version_info[1]}")')"

need_place
free_mb="$(($(stat -f --format='%a * %S' "$PREFIX") / 1000000))"
[ "$free_mb" -ge "$NEEDED_MB" ] || fail "$free_mb MB free in $PREFIX; expected $NEEDED_MB MB"
adopt_old_layout
reason="$(why_no_restart)"
[ -z "$reason" ] || fail "$reason: nothing was changed; expected a vehicle on the ground, disarmed, or" \
    "'${AS_ROOT}systemctl stop companion', and this command again"

cleanup() {
    [ -z "$work" ] || rm -rf "$work"
    [ -z "${folder:-}" ] || [ -e "$folder/COMPLETE" ] || rm -rf "$folder"
}
trap cleanup EXIT

if [ -d "$HERE/wheels" ]; then
    readonly SOURCE="$HERE" UNIT_SOURCE="$HERE/companion.service"
    wheels="$HERE/wheels"
    [ "$(cat "$HERE/ARCHITECTURE")" = "$(uname -m)" ] \
        || fail "this release is for $(cat "$HERE/ARCHITECTURE"), this machine is $(uname -m)"
    grep -qx "$TAG" "$HERE/PYTHONS" \
        || fail "this machine's Python is $TAG; expected one of: $(tr '\n' ' ' <"$HERE/PYTHONS")(Debian 12 or 13)"
    (cd "$HERE" && sha256sum --check --quiet --strict SHA256SUMS) >/dev/null 2>&1 \
        || fail "a file of the release is damaged or missing; expected what SHA256SUMS says: copy it again"
    revision="$(cat "$HERE/REVISION")"
else
    readonly SOURCE="$(dirname "$HERE")" UNIT_SOURCE="$HERE/companion.service"
    python3 -c 'import ensurepip' 2>/dev/null || fail "needs python3-venv; run: apt install python3-venv"
    work="$(mktemp -d)"
    wheels="$work/wheels"
    # built from a copy: a build leaves files, and the checkout may be somebody else's
    install -d "$work/source"
    for name in companion sitl calibration configs pyproject.toml README.md LICENSE; do
        cp -r "$SOURCE/$name" "$work/source/"
    done
    python3 -m venv "$work/venv"
    "${gently[@]}" "$work/venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --wheel-dir "$wheels" \
        -c "$SOURCE/constraints.txt" "${work}/source[release]" pip >"$work/log" 2>&1 \
        || fail "the wheels cannot be built, and nothing was changed: $(grep -m 1 -o "ERROR.*" "$work/log" || tail -n 1 "$work/log")"
    # which stands in each flight's log
    revision="$(git -C "$SOURCE" describe --always --dirty --abbrev=12 --exclude='*' 2>/dev/null || true)"
fi
own="$(echo "$wheels/$DISTRIBUTION"-*.whl)"
[ -e "$own" ] || fail "no wheel of the companion in $wheels"
version="$(basename "$own" | cut -d- -f2)"
identity="$(sha256sum <"$own" | cut -d' ' -f1) $TAG $(uname -m)"

# the folder's name: the version's, with a number if one of that name and other content is in use or was before
name="$version" number=1
while complete "$name" && [ "$(cat "$VERSIONS/$name/IDENTITY" 2>/dev/null)" != "$identity" ] \
    && { [ "$name" = "$(in_use)" ] || [ "$name" = "$(one_before)" ]; }; do
    number=$((number + 1))
    name="$version-$number"
done

getent group companion >/dev/null || groupadd --system companion
id companion >/dev/null 2>&1 || useradd --system --gid companion --home-dir /var/lib/companion \
    --no-create-home --shell /usr/sbin/nologin companion
# the unit names these; a system without a camera or GPIO lacks some of them
for group in dialout i2c spi video gpio; do
    getent group "$group" >/dev/null || groupadd --system "$group"
done

if complete "$name" && [ "$(cat "$VERSIONS/$name/IDENTITY" 2>/dev/null)" = "$identity" ]; then
    say "$name is there already"
else
    before="$(in_use)"
    say "laying down $name${before:+ beside $before, which goes on}: a few minutes on a Raspberry Pi"
    folder="$VERSIONS/$name"
    log="$PREFIX/install.log"
    rm -rf "$folder"
    install -d "$folder"
    # system site packages: picamera2, lgpio and spidev come from the distribution
    python3 -m venv --system-site-packages --without-pip "$folder/.venv"
    pip="$(echo "$wheels"/pip-*.whl)"
    mapfile -t lgpio < <(compgen -G "$wheels/*lgpio-*-$TAG-*.whl" || true)
    "${gently[@]}" "$folder/.venv/bin/python" "$pip/pip" install --quiet --disable-pip-version-check --no-index \
        --find-links "$wheels" --ignore-installed --no-cache-dir --root-user-action ignore \
        -c "$SOURCE/constraints.txt" "${own}[release]" "${lgpio[@]}" >"$log" 2>&1 \
        || fail "the packages cannot be installed, and nothing was changed: $(grep -m 1 -o "ERROR.*" "$log" || tail -n 1 "$log")"
    rm -f "$log"
    # from "/": where we are may hold a package of that name, a checkout
    package="$(cd / && "$folder/.venv/bin/python" -c 'import companion; print(companion.__path__[0])')"
    ln -s "${package#"$folder/"}/configs" "$folder/configs"
    # beside the installer: the one of who installs, not of who develops
    cp "$HERE/README.md" "$SOURCE/CHANGELOG.md" "$SOURCE/LICENSE" "$folder/"
    [ ! -d "$SOURCE/docs" ] || cp -r "$SOURCE/docs" "$folder/"
    put_file "$UNIT_SOURCE" "$folder/companion.service"
    echo "$revision" >"$folder/REVISION"
    echo "$identity" >"$folder/IDENTITY"
    said="$(cd / && "$folder/.venv/bin/companion" --version 2>&1)" || true
    [ "$said" = "$version" ] || fail "the new version does not run, and nothing was changed: $(tail -n 1 <<<"$said")"
    (cd / && "$folder/.venv/bin/python" -c 'import companion.app.command, companion.app.app' 2>"$folder/import.log") \
        || fail "the new version does not load, and nothing was changed: $(tail -n 1 "$folder/import.log")"
    rm -f "$folder/import.log"
    sync -f "$folder" 2>/dev/null || true
    touch "$folder/COMPLETE"
fi

# where flights go, and the user's home, there for the first check too; systemd would make it at the first start
[ -d "$FLIGHTS" ] || install -d -o "$SERVICE_USER" -g "$SERVICE_USER" "$FLIGHTS"
# a link to a disk that is not there now is the settings' too
[ -e "$SETTINGS/companion.yaml" ] || [ -L "$SETTINGS/companion.yaml" ] \
    || install -m 0644 "$VERSIONS/$name/configs/companion.yaml" "$SETTINGS/companion.yaml"
install -d "$PREFIX/tools"
for file in versions.sh companion-rollback; do
    install -m 0755 "$HERE/$file" "$PREFIX/tools/$file.new" && mv -T "$PREFIX/tools/$file.new" "$PREFIX/tools/$file"
done
put_link "$PREFIX/tools/companion-rollback" "$PROGRAMS_FOLDER/companion-rollback"

first="$(in_use)"
activate "$name"
[ -n "$first" ] && exit 0
say "next, on a Raspberry Pi, UARTs, I2C and the rest: ${AS_ROOT}companion setup"
say "then look through $SETTINGS/companion.yaml, and see what is missing: ${AS_SERVICE}companion check"
say "then: ${AS_ROOT}systemctl enable --now companion"
say "it stands by and flies nothing unasked: ${AS_ROOT}companion status, ${AS_ROOT}companion order land;" \
    "see docs/how-to/service.md"
say "root and the group companion may ask it: ${AS_ROOT}usermod -aG companion ${SUDO_USER:-USER}, and a new login"
