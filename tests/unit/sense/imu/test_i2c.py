"""The register bus and the little format that carries it to a simulator in another process."""

import asyncio
import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.errors import DeviceMissing
from companion.base.formats import bus_format
from companion.base.formats.bus_format import BusFormatError, ReadRequest, WriteRequest
from companion.config import ConfigError
from companion.sense.imu.i2c import SmbusBus, SocketBus, open_bus
from sitl.devices.socket_servers import answer, serve_registers

BYTE = st.integers(0, 255)


class Memory:
    """256 registers at address 0x68."""

    def __init__(self) -> None:
        self.registers = bytearray(256)

    def read(self, address: int, register: int, length: int) -> bytes:
        self._check(address)
        return bytes((self.registers * 5)[register : register + length])

    def write(self, address: int, register: int, value: int) -> None:
        self._check(address)
        self.registers[register] = value

    def _check(self, address: int) -> None:
        if address != 0x68:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")


@given(
    st.one_of(
        st.builds(ReadRequest, BYTE, BYTE, st.integers(1, bus_format.MAXIMUM_READ)),
        st.builds(WriteRequest, BYTE, BYTE, BYTE),
    )
)
def test_requests_survive_the_wire(request_: ReadRequest | WriteRequest) -> None:
    assert bus_format.decode_request(bus_format.encode_request(request_)) == request_


@given(st.binary(max_size=12))
def test_whatever_comes_is_a_request_or_refused(data: bytes) -> None:
    try:
        request = bus_format.decode_request(data)
    except BusFormatError:
        return
    assert bus_format.encode_request(request) == data


def test_the_bytes_are_those_of_the_description() -> None:
    assert bus_format.encode_request(ReadRequest(0x68, 0x74, 504)) == bytes.fromhex("526874f801")
    assert bus_format.encode_request(WriteRequest(0x68, 0x6B, 0x80)) == bytes.fromhex("57686b8000")
    assert bus_format.encode_reply(0, b"\x71") == bytes.fromhex("00010071")
    assert bus_format.encode_reply(121) == bytes.fromhex("790000")


@pytest.mark.parametrize(
    "request_",
    [
        ReadRequest(0x68, 0, 0),
        ReadRequest(0x68, 0, bus_format.MAXIMUM_READ + 1),
        WriteRequest(0x68, 0, 256),
        WriteRequest(0x68, 0, -1),
        ReadRequest(256, 0, 1),
    ],
)
def test_numbers_that_do_not_fit_are_refused(request_: ReadRequest | WriteRequest) -> None:
    with pytest.raises(BusFormatError):
        bus_format.encode_request(request_)


def test_a_bus_fault_is_answered_with_its_number() -> None:
    reply = answer(Memory(), bus_format.encode_request(ReadRequest(0x0C, 0, 1)))
    assert bus_format.decode_reply_header(reply) == (errno.EREMOTEIO, 0)


# ---------------------------------------------------------------- over a real socket


class RegisterServer:
    """A register server on its own loop in its own thread, as a simulator's process has it."""

    def __init__(self, path: Path) -> None:
        self.memory = Memory()
        self._path = path
        self._loop = asyncio.new_event_loop()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        assert self._started.wait(5.0)

    def _run(self) -> None:
        self._server = self._loop.run_until_complete(serve_registers(self.memory, self._path))
        self._started.set()
        self._loop.run_forever()

    def stop(self) -> None:
        def end() -> None:
            self._server.close()
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.call_soon(self._loop.stop)

        self._loop.call_soon_threadsafe(end)
        self._thread.join(5.0)
        self._loop.run_until_complete(asyncio.sleep(0))
        self._loop.close()


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[RegisterServer]:
    peer = RegisterServer(tmp_path / "bus.sock")
    yield peer
    peer.stop()


def test_registers_are_read_and_written_over_the_socket(peer: RegisterServer, tmp_path: Path) -> None:
    bus = SocketBus(tmp_path / "bus.sock")
    bus.write(0x68, 0x6B, 0x81)
    assert bus.read(0x68, 0x6A, 3) == b"\x00\x81\x00"
    assert len(bus.read(0x68, 0x00, 512)) == 512
    bus.close()


def test_a_bus_fault_comes_over_the_socket_and_the_next_transaction_works(
    peer: RegisterServer, tmp_path: Path
) -> None:
    bus = SocketBus(tmp_path / "bus.sock")
    with pytest.raises(OSError, match="Remote I/O error"):
        bus.read(0x0C, 0x00, 1)
    assert bus.read(0x68, 0x00, 1) == b"\x00"
    bus.close()


def test_a_simulator_that_restarts_is_found_again(tmp_path: Path) -> None:
    bus = SocketBus(tmp_path / "bus.sock")
    with pytest.raises(OSError, match=r"bus at .*bus\.sock"):
        bus.read(0x68, 0x00, 1)
    first = RegisterServer(tmp_path / "bus.sock")
    assert bus.read(0x68, 0x00, 1) == b"\x00"
    first.stop()
    with pytest.raises(OSError, match=r"bus at .*bus\.sock"):
        bus.read(0x68, 0x00, 1)
    second = RegisterServer(tmp_path / "bus.sock")
    assert bus.read(0x68, 0x00, 1) == b"\x00"
    bus.close()
    second.stop()


# ---------------------------------------------------------------- the setting


@pytest.mark.parametrize(
    "spec",
    [
        *("", "i2c", "i2c:", "i2c:x", "i2c:-1", "i2c:²", "socket:"),
        *("spi:", "spi:0", "spi:0.", "spi:a.b", "spi:0.0.0"),
    ],
)
def test_a_bus_that_is_none_is_refused_with_what_is_expected(spec: str) -> None:
    with pytest.raises(ConfigError, match=r"expected i2c:NUMBER, spi:BUS.SELECT or socket:PATH"):
        open_bus(spec)


def test_an_adapter_that_is_not_there_is_reported_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^bus 'i2c:250': /dev/i2c-250 cannot be opened: No such file"):
        open_bus("i2c:250")


def test_the_socket_bus_connects_only_when_it_is_used() -> None:
    assert isinstance(open_bus("socket:/nowhere/imu.sock"), SocketBus)


class FakeSmbus:
    """What smbus2.SMBus does on an adapter with the given functions."""

    def __init__(self, funcs: int, device: Path) -> None:
        self.funcs = funcs
        self.written: list[tuple[int, int, int]] = []
        self.fd = os.open(device, os.O_RDONLY)

    def close(self) -> None:
        os.close(self.fd)

    def i2c_rdwr(self, ask: object, answer: object) -> None:
        register = bytes(ask)[0]  # type: ignore[call-overload]
        for k in range(answer.len):  # type: ignore[attr-defined]
            answer.buf[k] = bytes((register + k & 0xFF,))  # type: ignore[attr-defined]

    def read_i2c_block_data(self, address: int, register: int, length: int) -> list[int]:
        return [register + k for k in range(length)]

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self.written.append((address, register, value))


Adapter = Callable[[int], FakeSmbus]


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Adapter]:
    """Has /dev/i2c-1 be an adapter with the given functions; a file stands for the device."""
    device, made = tmp_path / "i2c-1", list[FakeSmbus]()
    device.touch()

    def with_functions(funcs: int) -> FakeSmbus:
        made.append(FakeSmbus(funcs, device))
        monkeypatch.setattr("companion.sense.imu.i2c.smbus2.SMBus", lambda _number: made[-1])
        return made[-1]

    yield with_functions
    for fake in made:
        with suppress(OSError):
            fake.close()


def test_a_plain_i2c_adapter_reads_any_length_at_once(adapter: Adapter) -> None:
    fake = adapter(0x00000001)
    bus = SmbusBus(1)
    assert bus.read(0x68, 10, 100) == bytes(range(10, 110))
    bus.write(0x68, 0x6B, 1)
    assert fake.written == [(0x68, 0x6B, 1)]


def test_an_smbus_adapter_reads_a_block_and_refuses_more(adapter: Adapter) -> None:
    adapter(0x04000000)
    bus = SmbusBus(1)
    assert bus.read(0x68, 10, 32) == bytes(range(10, 42))
    with pytest.raises(OSError, match="at most 32"):
        bus.read(0x68, 10, 33)


def test_an_adapter_that_another_program_of_ours_has_is_waited_for(adapter: Adapter) -> None:
    adapter(0x00000001)
    first = open_bus("i2c:1")
    adapter(0x00000001)
    with pytest.raises(DeviceMissing, match=r"^bus 'i2c:1': /dev/i2c-1 cannot be opened: busy; expected"):
        open_bus("i2c:1")
    first.close()
    adapter(0x00000001)
    open_bus("i2c:1").close()
