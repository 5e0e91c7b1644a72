"""Unless somebody says otherwise, no socket of ours can be reached from another computer."""

import os
import socket
import subprocess
import sys
from contextlib import ExitStack, closing, suppress
from ipaddress import ip_address
from pathlib import Path

import pytest

from companion.config import CONFIG_FOLDER, CONNECTION_FORM, LinkConfig, load_config
from companion.link.transport import UdpTransport, open_transport


def free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(closing(socket.socket())) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def addresses(process: int) -> set[str]:
    """The local addresses of a process's IP sockets, by the kernel's own tables (Linux)."""
    inodes = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        with suppress(OSError):  # closed meanwhile, as the listing's own
            kind, _, inode = str(link.readlink()).partition(":")
            if kind == "socket":
                inodes.add(inode.strip("[]"))
    found = set()
    for table in ("tcp", "udp", "tcp6", "udp6"):
        path = Path(f"/proc/{process}/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else ():
            words = line.split()
            if words[9] in inodes:
                packed = bytes.fromhex(words[1].partition(":")[0])
                # four bytes at a time, each group in the order of the machine
                groups = (packed[k : k + 4][::-1] for k in range(0, len(packed), 4))
                found.add(str(ip_address(b"".join(groups))))
    return found


def test_the_table_of_sockets_is_read_right() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as one:
        one.bind(("127.0.0.3", 0))
        assert "127.0.0.3" in addresses(os.getpid())


@pytest.mark.parametrize("config", [LinkConfig(), load_config(CONFIG_FOLDER / "companion.yaml").link])
def test_the_link_listens_at_this_computer_alone(config: LinkConfig) -> None:
    form = CONNECTION_FORM.fullmatch(config.connection)
    assert form is not None
    assert form["host"] is None or ip_address(form["host"]).is_loopback


async def test_where_the_link_listens_is_where_it_was_set() -> None:
    transport = await open_transport(f"udpin:127.0.0.1:{free_ports(1)[0]}")
    assert isinstance(transport, UdpTransport)
    assert addresses(os.getpid()) >= {"127.0.0.1"}
    assert "0.0.0.0" not in addresses(os.getpid())
    transport.close()


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="reads Linux's tables of sockets")
def test_a_served_vehicle_is_on_loopback() -> None:
    udp, ground, tcp = map(str, free_ports(3))
    command = [sys.executable, "-m", "sitl.cli", "--port", udp, "--gcs-port", ground, "--tcp-port", tcp]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert any("Ctrl-C stops it" in line for line in process.stdout)
            found = addresses(process.pid)
        finally:
            process.terminate()
    assert found
    assert all(ip_address(address).is_loopback for address in found), found
