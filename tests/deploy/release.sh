#!/usr/bin/env bash
# A release under a real systemd, without a network: a Debian container that boots it.
#   sudo tests/deploy/release.sh [FOLDER]   FOLDER (else /var/tmp/companion-release) is kept, for the next time
# Installs the release into a system that has Python and nothing else, enables and boots it; upgrades it while it stands
# by; a release that does not start, one that starts and ends, one that is damaged and one that the settings do not fit:
# taken back or refused, the service up; goes back by companion-rollback, downgrades, reboots, removes. Throughout the
# page answers to its token, the signing key is read, and owner and mode of both stay. Pins under the unit: a simulated
# gpiochip (gpiochip.c) beneath lgpio, where the release has that.
# SUITES: the Debians (else "bookworm trixie"). PYTHON: the Python whose pip fetches the wheels (else python3).
# PATIENCE_S: how long a service may take to answer (else 120 s here, and the installer's own time in it).
# BUNDLE: a release that is built already. OLD: a checkout of 0.1, which is installed first and upgraded.
# Exit codes: 0 all well, 1 something is not, 77 skipped, with one line that says why.
set -euo pipefail
readonly SOURCE="$(cd "$(dirname "$0")/../.." && pwd)"
readonly FOLDER="$(realpath -m "${1:-/var/tmp/companion-release}")"
readonly PYTHON="${PYTHON:-python3}"
# the mirror of this machine, unless told
readonly MIRROR="${MIRROR:-$(sed -n "s/^deb[^h]*\(http[^ ]*\).*/\1/p; s/^URIs: *//p" /etc/apt/sources.list /etc/apt/sources.list.d/* 2>/dev/null | head -n 1)}"
readonly SUITES="${SUITES:-bookworm trixie}"
readonly INSTALLER_PATIENCE_S="${PATIENCE_S:-}"
readonly PATIENCE_S="${PATIENCE_S:-120}"
readonly TOKEN=0123456789abcdef0123
suite="" ROOT="" container="" leader=""

# shellcheck source=tests/deploy/container.bash
. "$SOURCE/tests/deploy/container.bash"

skip() { echo "release: skipped: $*"; exit 77; }
fail() { echo "release: failed: ${suite:+$suite: }$*"; exit 1; }
step() { echo "release: ${suite:+$suite: }$* ($SECONDS s)"; }

[ "$(id -u)" -eq 0 ] || skip "needs root, for a container"
for program in debootstrap systemd-nspawn nsenter tar; do
    command -v "$program" >/dev/null || skip "no $program; apt install debootstrap systemd-container"
done
"$PYTHON" -m pip --version >/dev/null 2>&1 || skip "$PYTHON has no pip"
install -d "$FOLDER"

# a release of another version made of the first: only our own wheel differs. $1: its version; $2: a line of Python
# that its service begins with
make_release() {
    local source="$FOLDER/source" folder="$FOLDER/companion-$1-$(uname -m)"
    rm -rf "$source" "$folder"
    install -d "$source"
    for name in companion sitl calibration configs pyproject.toml README.md LICENSE; do cp -r "$SOURCE/$name" "$source/"; done
    sed -i "s/^__version__ = .*/__version__ = \"$1\"/" "$source/companion/__init__.py"
    [ -z "${2:-}" ] || "$PYTHON" - "$source/companion/app/command.py" "$2" <<'END'
import pathlib, sys
path = pathlib.Path(sys.argv[1])
text, head = path.read_text(), "    prepare_opencv()\n    config = output.shown(load_config(config_path))\n    clear"
assert text.count(head) == 1
path.write_text(text.replace(head, f"    {sys.argv[2]}\n{head}"))
END
    cp -rl "$first" "$folder"
    rm "$folder"/wheels/companion_landing-*.whl "$folder/SHA256SUMS"
    "$PYTHON" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$folder/wheels" "$source" \
        >"$FOLDER/pip.log" 2>&1 || fail "the wheel of $1: $(tail -n 1 "$FOLDER/pip.log")"
    (cd "$folder" && find . -type f ! -name SHA256SUMS -print0 | sort -z | xargs -0 sha256sum >SHA256SUMS)
}

put() { rm -rf "$ROOT/release"; cp -rl "$1" "$ROOT/release"; }
installer() { inside env ${INSTALLER_PATIENCE_S:+COMPANION_PATIENCE_S="$INSTALLER_PATIENCE_S"} /release/install.sh >"$FOLDER/install.log" 2>&1; }
said() { tail -n 1 "$FOLDER/install.log"; }
version_in_use() { inside companion --version; }
restarts() { inside systemctl show companion --property=NRestarts --value; }

# the service is up with that version, the page answers to the token, the key is read, nothing has another owner
holds() {
    local version="$1" what="$2"
    until_well systemctl is-active companion || fail "$what: not active: $(inside systemctl status companion | tail -n 3)"
    [ "$(version_in_use)" = "$version" ] || fail "$what: $(version_in_use) is in use, expected $version"
    inside readlink "/proc/$(main_process)/cwd" >/dev/null
    [ "$(inside stat --format='%U:%G %a' /etc/companion/page-token /etc/companion/signing-key /etc/companion/companion.yaml \
        | tr '\n' ' ')" = "companion:companion 600 companion:companion 600 root:root 644 " ] \
        || fail "$what: owners changed: $(inside stat --format='%n %U:%G %a' /etc/companion/*)"
    until_well /release-test/ask-page || fail "$what: the page does not answer to its token"
    inside sh -c "tr '\0' ' ' </proc/$(main_process)/cmdline" | grep -q "/opt/companion/versions/" \
        || fail "$what: it runs from no version's own folder"
}

if [ -n "${BUNDLE:-}" ]; then
    cp "$BUNDLE" "$FOLDER/"
else
    step "the release"
    env PYTHON="$PYTHON" "$SOURCE/systemd/release.sh" "$FOLDER" "$(uname -m)" || fail "systemd/release.sh"
fi
version="$(sed -n 's/^__version__ = "\(.*\)"/\1/p' "$SOURCE/companion/__init__.py")"
first="$FOLDER/companion-$version-$(uname -m)"
rm -rf "$FOLDER"/companion-*/
tar --extract --file "$first.tar" --directory "$FOLDER"
step "releases that follow it"
make_release 9.1.0
make_release 9.2.0 'raise RuntimeError("a fault of this release")'
make_release 9.3.0 'import threading, os; threading.Timer(4.0, os._exit, (1,)).start()'
readonly NEXT="$FOLDER/companion-9.1.0-$(uname -m)" RAISES="$FOLDER/companion-9.2.0-$(uname -m)" \
    ENDS="$FOLDER/companion-9.3.0-$(uname -m)"
pins=""
if command -v cc >/dev/null; then
    cc -shared -fPIC -O1 -o "$FOLDER/gpiochip.so" "$SOURCE/tests/deploy/gpiochip.c" -ldl -lpthread && pins=yes
fi

try_suite() {
    ROOT="$FOLDER/$suite"
    if [ ! -x "$ROOT/usr/bin/systemctl" ]; then
        step "a Debian root"
        debootstrap --include=systemd,systemd-sysv,dbus,python3,procps "$suite" "$ROOT" "$MIRROR" \
            >"$FOLDER/debootstrap.log" 2>&1 \
            || skip "debootstrap from $MIRROR: $(tail -n 1 "$FOLDER/debootstrap.log")"
    fi
    # also what a run that was broken off has left: the first installation is to be one
    rm -rf "$ROOT/etc/companion" "$ROOT/var/lib/companion" "$ROOT/release-test" "$ROOT/opt/companion" \
        "$ROOT"/etc/systemd/system/companion.service* "$ROOT"/etc/systemd/system/*.wants/companion.service \
        "$ROOT"/usr/local/bin/*companion* "$ROOT"/usr/local/bin/calibrate-*
    install -d "$ROOT/release-test"
    cat >"$ROOT/release-test/ask-page" <<END
#!/bin/sh
exec /opt/companion/current/.venv/bin/python - <<'PY'
import asyncio, aiohttp
async def main():
    async with aiohttp.ClientSession() as session:
        async with session.ws_connect("http://127.0.0.1:8080/live", headers={"Origin": "http://127.0.0.1:8080"}) as page:
            await page.send_str("$TOKEN")
            message = await page.receive(timeout=5)
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
asyncio.run(main())
PY
END
    chmod +x "$ROOT/release-test/ask-page"
    step "boot"
    boot || skip "systemd does not boot in a container here: $(tail -n 1 "$FOLDER/boot.log")"
    list_files >"$FOLDER/before"

    step "install $version"
    put "$first"
    installer || fail "install.sh: $(said)"
    step "installed"
    # before the first start: where flights will be kept, and what there is to ask
    inside runuser -u companion -- companion check --no-link --json - >"$FOLDER/check.json" || [ $? -eq 1 ] \
        || fail "the first check: exit code $?"
    grep -q "GB free for /var/lib/companion\"" "$FOLDER/check.json" || fail "the first check: $(grep -m 1 free "$FOLDER/check.json")"
    local answer; answer="$(inside companion status 2>&1 || true)"
    grep -q "companion.service is stopped" <<<"$answer" || fail "status before the first start: $answer"
    ! grep -q "make " "$ROOT/opt/companion/current/README.md" || fail "the release's README names make"
    # with devices that are not there, a page that asks for a token, and a key
    inside sh -c "install -m 0600 -o companion -g companion /dev/null /etc/companion/page-token; echo $TOKEN >/etc/companion/page-token
        install -m 0600 -o companion -g companion /dev/null /etc/companion/signing-key; echo a passphrase >/etc/companion/signing-key
        printf 'serve: {address: \"0.0.0.0:8080\", token_file: /etc/companion/page-token}\nlink: {connection: \"udpin:127.0.0.1:14540\", signing_key: /etc/companion/signing-key, actions: pymavlink}\n' >/etc/companion/companion.yaml"
    inside systemctl enable --quiet --now companion || fail "enable: $(inside journalctl --unit companion --no-pager --output cat | tail -n 5)"
    holds "$version" "installed"
    answer="$(inside ps -o ni= -p "$(main_process)" | tr -d ' ') $(inside systemctl show companion --property=CPUWeight --value)"
    [ "$answer" = "-10 1000" ] || fail "nice and weight: $answer"

    step "upgrade while standing by"
    local before; before="$(main_process)"
    put "$NEXT"
    installer || fail "the upgrade: $(said)"
    holds 9.1.0 "upgraded"
    [ "$(main_process)" != "$before" ] || fail "the service was not restarted"
    grep -q "restarting the service" "$FOLDER/install.log" || fail "the restart was not told"

    for faulty in "$RAISES" "$ENDS"; do
        step "upgrade to one that fails: $(basename "$faulty")"
        put "$faulty"
        local code=0; installer || code=$?
        [ "$code" -eq 1 ] || fail "a faulty release: exit code $code, expected 1: $(said)"
        step "$(said)"
        holds 9.1.0 "taken back"
    done

    step "refused: damaged, and settings that it cannot read"
    before="$(main_process)"
    put "$first"
    rm "$ROOT/release/PYTHONS"; echo cp00 >"$ROOT/release/PYTHONS"
    code=0; installer || code=$?
    [ "$code" -eq 2 ] || fail "a release for other Pythons: exit code $code: $(said)"
    put "$first"
    rm "$ROOT/release/README.md"
    code=0; installer || code=$?
    [ "$code" -eq 2 ] || fail "a damaged release: exit code $code: $(said)"
    put "$first"
    inside chown root:root /etc/companion/page-token
    code=0; installer || code=$?
    [ "$code" -eq 2 ] || fail "a token that the service cannot read: exit code $code: $(said)"
    step "$(said)"
    inside chown companion:companion /etc/companion/page-token
    [ "$(main_process)" = "$before" ] || fail "refused, and the service was restarted"
    holds 9.1.0 "refused"

    step "companion-rollback, and downgrade, and upgrade again"
    inside env ${INSTALLER_PATIENCE_S:+COMPANION_PATIENCE_S="$INSTALLER_PATIENCE_S"} companion-rollback \
        >"$FOLDER/install.log" 2>&1 || fail "companion-rollback: $(said)"
    holds "$version" "rolled back"
    put "$NEXT"
    installer || fail "the upgrade: $(said)"
    holds 9.1.0 "upgraded again"
    put "$first"
    installer || fail "the downgrade: $(said)"
    holds "$version" "downgraded"

    step "reboot"
    shut_down
    boot || fail "it does not boot: $(tail -n 1 "$FOLDER/boot.log")"
    holds "$version" "rebooted"

    if [ -n "$pins" ] && inside /opt/companion/current/.venv/bin/python -c 'import importlib.util, sys; sys.exit(importlib.util.find_spec("lgpio") is None)'; then
        step "pins under the unit"
        cp "$FOLDER/gpiochip.so" "$ROOT/usr/lib/gpiochip.so"
        install -d "$ROOT/etc/systemd/system/companion.service.d"
        printf '[Service]\nEnvironment=LD_PRELOAD=/usr/lib/gpiochip.so\n' \
            >"$ROOT/etc/systemd/system/companion.service.d/pins.conf"
        inside sh -c "printf 'sense: {range: {kind: gpio, trigger_pin: 23, echo_pin: 24}}\n' >>/etc/companion/companion.yaml"
        inside systemctl daemon-reload
        inside systemctl restart companion
        until_well /opt/companion/current/.venv/bin/python -c '
import json, subprocess, sys
told = json.loads(subprocess.run(["companion", "status", "--json"], capture_output=True, text=True).stdout)
distance = [i for i in told["inputs"] if i["name"] == "ultrasonic" and not i["silent"] and i["rate_hz"] > 5.0]
sys.exit(not distance)' || fail "no distance by pins: $(inside journalctl --unit companion --no-pager | tail -n 5)"
        step "$(inside companion status | grep ultrasonic)"
        rm -r "$ROOT/etc/systemd/system/companion.service.d" "$ROOT/usr/lib/gpiochip.so"
        inside systemctl daemon-reload
    else
        step "pins: left out, there is no C compiler or no lgpio for this Python here"
    fi

    step "remove"
    inside /release/install.sh --remove >"$FOLDER/install.log" 2>&1 || fail "remove: $(said)"
    [ -e "$ROOT/var/lib/companion" ] && [ -e "$ROOT/etc/companion/signing-key" ] || fail "logs, settings or keys are gone"
    list_files >"$FOLDER/after"
    local left
    left="$(comm -13 "$FOLDER/before" "$FOLDER/after" | grep -v -e '^/etc/companion\(/\|$\)' -e '^/var/lib/companion\(/\|$\)' \
        -e '^/release\(/\|$\)' -e '^/etc/\(passwd\|group\|shadow\|gshadow\)-$' -e '^/var/lib/\(systemd\|apt\)/' -e '^/etc/resolv.conf' || true)"
    [ -z "$left" ] || fail "removed, and still there: $left"
    shut_down
}

for suite in $SUITES; do try_suite; done
suite=""
step "install, upgrade, take back, refuse, roll back, downgrade, reboot and removal are well"
