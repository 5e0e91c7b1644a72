# shellcheck shell=bash
# Versions of the companion on this machine: switching between them, checking the one that runs, going back.
# install.sh and companion-rollback read it; it does nothing by itself.
#
#   /opt/companion/versions/VERSION   a version: its environment (.venv), unit, documents; never changed once complete
#   /opt/companion/current            link to the version in use; the unit and /usr/local/bin go through it
#   /opt/companion/previous           link to the one before it
# A process that runs keeps its own version: the programs' first lines name the Python of their folder, not the link.

umask 022
# tests put another root before all paths
readonly BASE="${COMPANION_BASE:-}"
readonly PREFIX="$BASE/opt/companion"
readonly SETTINGS="$BASE/etc/companion"
readonly FLIGHTS="$BASE/var/lib/companion"
readonly UNIT="$BASE/etc/systemd/system/companion.service"
readonly PROGRAMS_FOLDER="$BASE/usr/local/bin"
readonly VERSIONS="$PREFIX/versions"
readonly CURRENT="$PREFIX/current"
readonly PREVIOUS="$PREFIX/previous"
readonly SERVICE_USER="${COMPANION_USER:-companion}"
# for the service, and for the calibrations and checks by hand
readonly PROGRAMS=(companion companion-sitl calibrate-camera calibrate-magnetometer calibrate-mount)
# before the commands that a person is told: who is root without sudo may have none
readonly AS_ROOT="${SUDO_USER:+sudo }"
if [ -n "$AS_ROOT" ]; then AS_SERVICE="sudo -u $SERVICE_USER "; else AS_SERVICE="runuser -u $SERVICE_USER -- "; fi
readonly AS_SERVICE
# how long a new version may take to be up, and how long it then has to stay up: longer than its watchdog
readonly PATIENCE_S="${COMPANION_PATIENCE_S:-60}"
readonly STEADY_S="${COMPANION_STEADY_S:-5}"

fail() { echo "$(basename "$0"): $*" >&2; exit 2; }
# an ssh connection that is lost must not stop a switch half-way
say() { echo "$*" 2>/dev/null || true; }

need_root() {
    [ -n "$BASE" ] || [ "$(id -u)" -eq 0 ] || fail "needs root; run: sudo $0"
    command -v systemctl >/dev/null || fail "no systemctl here; expected a system that runs systemd"
}

# every folder that a switch writes to, before anything is changed; and nobody else does so meanwhile
need_place() {
    local folder
    for folder in "$PREFIX" "$VERSIONS" "$SETTINGS" "$PROGRAMS_FOLDER" "$(dirname "$UNIT")"; do
        install -d "$folder" 2>/dev/null && [ -w "$folder" ] \
            || fail "$folder cannot be written to, and nothing was changed; expected a folder on a disk that is not read-only"
    done
    exec 9>"$PREFIX/lock"
    flock --nonblock 9 || fail "another installation is under way, and nothing was changed; expected its end"
}

in_use() { [ -L "$CURRENT" ] && basename "$(readlink "$CURRENT")" || true; }
one_before() { [ -L "$PREVIOUS" ] && basename "$(readlink "$PREVIOUS")" || true; }
complete() { [ -e "$VERSIONS/$1/COMPLETE" ]; }
service_runs() { systemctl is-active --quiet companion.service; }
service_property() { systemctl show companion.service --property="$1" --value; }
# up, or about to be: systemd starts one that crashes again (activating), once the one before has ended (deactivating)
service_is_wanted() {
    local state
    while state="$(service_property ActiveState)" && [ "$state" = deactivating ]; do sleep 0.5; done
    [ "$state" = active ] || [ "$state" = activating ] || [ "$state" = reloading ]
}

# what stands at a path is replaced in one step, also if the power fails
put_link() { ln -sfn "$1" "$2.new" && mv -T "$2.new" "$2"; }
put_file() { install -m 0644 "$1" "$2.new" && mv -T "$2.new" "$2"; }

# the layout of 0.1: one version, straight in /opt/companion. It becomes a version like others, where it is
adopt_old_layout() {
    [ ! -L "$CURRENT" ] && [ -x "$PREFIX/.venv/bin/companion" ] && [ -e "$UNIT" ] || return 0
    local name
    name="$("$PREFIX/.venv/bin/companion" --version 2>/dev/null | tail -n 1)" || name=""
    name="${name:-0.1.0}"
    install -d "$VERSIONS/$name"
    ln -sfn ../../.venv "$VERSIONS/$name/.venv"
    put_file "$UNIT" "$VERSIONS/$name/companion.service"
    touch "$VERSIONS/$name/OLD_LAYOUT" "$VERSIONS/$name/COMPLETE"
    put_link "versions/$name" "$CURRENT"
}

# why the service must not be restarted now, as the program of a version (else of that in use) hears it; nothing: it may be
why_no_restart() {
    service_runs || return 0
    local told
    # 1: not healthy; it has answered all the same
    told="$(timeout 20 "$VERSIONS/${1:-$(in_use)}/.venv/bin/companion" status --json 2>&1)" || [ $? -eq 1 ] || {
        echo "the service runs and does not answer: $(tail -n 1 <<<"$told")"
        return 0
    }
    python3 - "$told" <<'END' || echo "the service's answer is not understood"
import json, sys
told = json.loads(sys.argv[1])
if told["order"] is not None or told["phase"] != "standby":
    print(f"the service is in {told['phase']}{', ' + told['order'] if told['order'] else ''}")
elif told["armed"]:
    print("the vehicle is armed")
END
}

# what the service cannot read of its settings, keys and tokens: a path a line
unreadable() {
    [ -d "$SETTINGS" ] || return 0
    runuser -u "$SERVICE_USER" -- find "$SETTINGS" ! -readable -print 2>/dev/null || true
}

# see, as the service's user and in its environment, whether a version accepts the settings; older ones cannot be asked
accepts_settings() {
    local python="$VERSIONS/$1/.venv/bin/python" environment
    [ -e "$SETTINGS/companion.yaml" ] || return 0
    (cd / && "$python" -c 'import companion.tools.preflight.start_check' 2>/dev/null) || return 0
    # a token may be in there; the lines of the unit and its drop-ins go back to systemd, which reads its own quoting
    mapfile -t environment < <(systemctl cat companion.service 2>/dev/null | sed -nE -e ':join;/\\$/{N;s/\\\n/ /;b join}' \
        -e 's/^[[:space:]]*(Environment(File)?)[[:space:]]*=[[:space:]]*/--property=\1=/p')
    systemd-run --quiet --pipe --wait --collect --uid="$SERVICE_USER" "${environment[@]}" --setenv=PYTHONDONTWRITEBYTECODE=1 \
        -- "$python" -m companion.tools.preflight.start_check "$SETTINGS/companion.yaml" 2>&1
}

# put a version in place: link, programs, unit
switch_to() {
    local program
    put_link "versions/$1" "$CURRENT"
    for program in "${PROGRAMS[@]}"; do
        if [ -e "$VERSIONS/$1/.venv/bin/$program" ]; then
            put_link "$CURRENT/.venv/bin/$program" "$PROGRAMS_FOLDER/$program"
        else
            rm -f "$PROGRAMS_FOLDER/$program"
        fi
    done
    put_file "$VERSIONS/$1/companion.service" "$UNIT"
    sync -f "$UNIT" "$CURRENT" 2>/dev/null || true
    systemctl daemon-reload
}

# restart, and wait: active, answering, and still the same process after a while. Prints the reason if it is not
restart_is_healthy() {
    local until=$((SECONDS + PATIENCE_S)) since="@$(date +%s)" pid told
    systemctl reset-failed companion.service 2>/dev/null || true
    if ! told="$(timeout "$((2 * PATIENCE_S))" systemctl restart companion.service 2>&1)"; then
        echo "it does not start: $(why_down "$told")"
        return 1
    fi
    until service_runs && pid="$(service_property MainPID)" && answers; do
        if [ "$SECONDS" -ge "$until" ] || [ "$(service_property ActiveState)" = failed ]; then
            if service_runs; then
                # what it said last is not why: it may wait for a device, as it does in standby
                told="$(why_down "")"
                echo "it runs and gives no answer within $PATIENCE_S s${told:+; last it said: $told}"
            else
                echo "it does not come up: $(why_down "no answer within $PATIENCE_S s")"
            fi
            return 1
        fi
        sleep 0.5
    done
    sleep "$STEADY_S"
    if ! service_runs || [ "$(service_property MainPID)" != "$pid" ] || ! answers; then
        echo "it came up and went down again: $(why_down "within $STEADY_S s")"
        return 1
    fi
}

answers() {
    timeout 20 "$CURRENT/.venv/bin/companion" status --json >/dev/null 2>&1 || [ $? -eq 1 ]
}

# of what was said since the restart: why systemd ended it, and its own last line; else what is known otherwise
why_down() {
    local lines ended line
    lines="$(journalctl --unit companion.service --since "$since" --no-pager --output cat --lines 30 2>/dev/null)" || true
    ended="$(grep -o -m 1 -e 'Watchdog timeout.*' -e 'start operation timed out' <<<"$lines")" || true
    line="$(grep -v -e '^companion.service: ' -e '^Start' -e '^Stop' -e '^Failed to start' <<<"$lines" | tail -n 1)" || true
    line="${line:-$(tail -n 1 <<<"$1")}"
    echo "${ended:+$ended (too busy a machine?)${line:+; last it said: }}$line"
}

# Switch to a complete version, restart a service that runs, check it, and go back if it is not well.
# Exit code 1 of the script: it was taken back.
activate() {
    local name="$1" before earlier reason ran=no restarts=no
    before="$(in_use)"
    earlier="$(one_before)"
    complete "$name" || fail "$name is not installed; expected one of: $(list_versions | tr '\n' ' ')"
    reason="$(why_no_restart)"
    [ -z "$reason" ] || fail "$reason: nothing was switched, ${before:-nothing} stays in use; expected a vehicle on" \
        "the ground, disarmed, or '${AS_ROOT}systemctl stop companion', and this command again"
    reason="$(unreadable | tr '\n' ' ')"
    [ -z "$reason" ] || say "the service (user $SERVICE_USER) cannot read ${reason}: if it has to," \
        "${AS_ROOT}chown $SERVICE_USER: ${reason}"
    reason="$(accepts_settings "$name")" || fail "$name does not start with these settings; nothing was switched:" \
        "$(tail -n 1 <<<"$reason")"
    if [ "$name" = "$before" ]; then
        switch_to "$name"
        say "$name is in use already; the service was left alone"
        return 0
    fi
    service_is_wanted && ran=yes
    trap '' HUP
    trap 'take_back "$before" "$name" "$restarts" "interrupted"' INT TERM
    # first: the way back if the power fails now
    [ -z "$before" ] || put_link "versions/$before" "$PREVIOUS"
    switch_to "$name"
    if [ "$ran" = yes ]; then
        # an order may have come meanwhile: the checks and the switch take seconds
        reason="$(why_no_restart "$before")"
        [ -z "$reason" ] || take_back "$before" "$name" "$restarts" "$reason"
        restarts=yes
        say "restarting the service: it stands by, disarmed"
        reason="$(restart_is_healthy)" || take_back "$before" "$name" "$restarts" "$reason"
    fi
    trap - INT TERM
    prune
    if [ "$ran" = yes ]; then
        say "$name is in use; the service runs, and answers (before: $before; back: ${AS_ROOT}companion-rollback)"
    else
        say "$name is in use; the service does not run${before:+: ${AS_ROOT}systemctl start companion}"
    fi
}

# back to the version before; `restarts`: the service was restarted, and is again if it is not in flight by now
take_back() {
    local before="$1" name="$2" restarts="$3" reason="$4" flies=""
    trap - INT TERM
    [ "$restarts" = no ] || flies="$(why_no_restart "$name")"
    case "$flies" in
        "" | *"does not answer"*) ;;
        *) echo "$(basename "$0"): $name: $reason; $flies: $name stays in use" >&2; exit 1 ;;
    esac
    if [ -z "$before" ]; then
        echo "$(basename "$0"): $name: $reason; there is no version before it to go back to" >&2
        exit 1
    fi
    say "$name: $reason; going back to $before"
    switch_to "$before"
    if [ -n "$earlier" ]; then put_link "versions/$earlier" "$PREVIOUS"; else rm -f "$PREVIOUS"; fi
    if [ "$restarts" = yes ]; then
        reason="$(restart_is_healthy)" || {
            echo "$(basename "$0"): $before is back in use and not well either: $reason" >&2
            exit 1
        }
    fi
    echo "$(basename "$0"): $name was taken back; $before is in use$([ "$restarts" = yes ] && echo ', the service runs')" >&2
    exit 1
}

list_versions() {
    local folder
    for folder in "$VERSIONS"/*/; do
        if complete "$(basename "$folder")"; then basename "$folder"; fi
    done
}

# the version in use and the one before it are kept
prune() {
    local folder name
    for folder in "$VERSIONS"/*/; do
        name="$(basename "$folder")"
        case "$name" in "$(in_use)" | "$(one_before)") continue ;; esac
        # first: half a version must not be taken for a whole one
        rm -f "$folder/COMPLETE"
        [ ! -e "$folder/OLD_LAYOUT" ] || remove_old_layout
        rm -rf "$folder"
    done
}

remove_old_layout() {
    local name
    for name in companion sitl calibration configs .venv pyproject.toml constraints.txt README.md LICENSE REVISION; do
        rm -rf "${PREFIX:?}/$name"
    done
}
