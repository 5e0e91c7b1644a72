# shellcheck shell=bash
# A container that boots a real systemd from a Debian root: what service.sh and release.sh share. It wants FOLDER, ROOT,
# PATIENCE_S, and `container` and `leader` empty; it ends what it started when the script does.

# the words after the first run what follows them inside
enter() { entering=(nsenter --target "$leader" --all -- env --ignore-environment HOME=/root PIP_NO_INDEX=1
    PIP_FIND_LINKS=/wheels PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin); }

inside() { enter; "${entering[@]}" "$@"; }

# what is there, but for what is no file of the system's, and its own logs
list_files() {
    inside find / -xdev \( -path /proc -o -path /sys -o -path /dev -o -path /run -o -path /tmp -o -path /src \
        -o -path /wheels -o -path /var/log -o -path /var/tmp -o -path /root/.cache \) -prune -o -print | sort
}

# waits for a command inside to succeed
until_well() {
    local until=$((SECONDS + PATIENCE_S))
    until inside "$@" >/dev/null 2>&1; do
        [ "$SECONDS" -lt "$until" ] || return 1
        sleep 0.5
    done
}

shut_down() {
    [ -n "$container" ] || return 0
    # SIGRTMIN+4: an orderly power-off, as systemd(1) has it
    [ -z "$leader" ] || kill -s RTMIN+4 "$leader" 2>/dev/null || true
    for _ in $(seq 30); do kill -0 "$container" 2>/dev/null || break; sleep 0.5; done
    kill -KILL "$container" 2>/dev/null || true
    wait "$container" 2>/dev/null || true
    container="" leader=""
}
trap shut_down EXIT

boot() {
    # Debian's own daily work (apt's lists, dpkg's backups) is none of what is watched here
    ln -sf /dev/null "$ROOT/etc/systemd/system/timers.target"
    # no register: there is no machined to talk to; private-network: its ports are its own
    SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1 systemd-nspawn --quiet --boot --register=no --keep-unit \
        --private-network --console=pipe --directory="$ROOT" </dev/null >"$FOLDER/boot.log" 2>&1 &
    container=$!
    for _ in $(seq 60); do
        sleep 0.5
        leader="$(pgrep --parent "$container" | head -n 1)" || true
        [ -n "$leader" ] && inside systemctl is-active --quiet multi-user.target 2>/dev/null && return 0
        kill -0 "$container" 2>/dev/null || break
    done
    return 1
}

main_process() { inside systemctl show companion --property=MainPID --value; }

active_again() {  # another process than $1 is active
    local until=$((SECONDS + PATIENCE_S)) now
    while [ "$SECONDS" -lt "$until" ]; do
        now="$(main_process)"
        if [ "$now" != 0 ] && [ "$now" != "$1" ] && inside systemctl is-active --quiet companion; then
            return 0
        fi
        sleep 0.5
    done
    return 1
}
