"""Serial links over a pseudo-terminal: its other end is the vehicle's."""

from __future__ import annotations

import asyncio
import os
import pty
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import LinkError
from fg_gcs.link.clock import ticks
from fg_gcs.link.endpoint import Address, Change, Endpoint, Kind, Wire, parse_endpoint
from fg_gcs.link.opening import open_wire
from fg_gcs.link.router import Router
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.codec import Codec
from fg_gcs.wire.commands import heartbeat
from fg_gcs.wire.framing import Sender
from tests.link.test_tcp import fast

BAUD = 57600


class Plug:
    """A device of a name of our own that can be plugged in and pulled out."""

    def __init__(self, path: Path) -> None:
        self.path, self.vehicle = path, -1
        self.plug_in()

    def plug_in(self) -> None:
        self.vehicle, device = pty.openpty()
        tty.setraw(device)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(device))
        os.set_blocking(self.vehicle, False)
        self._device = device

    def pull_out(self) -> None:
        for descriptor in (self.vehicle, self._device):
            if descriptor >= 0:
                os.close(descriptor)
        self.vehicle = self._device = -1
        self.path.unlink(missing_ok=True)

    def heard(self) -> bytes:
        try:
            return os.read(self.vehicle, 65536)
        except BlockingIOError:
            return b""

    @property
    def endpoint(self) -> Endpoint:
        return parse_endpoint(f"serial:{self.path}:{BAUD}")


@pytest.fixture
def plug(tmp_path: Path) -> Iterator[Plug]:
    made = Plug(tmp_path / "ttyUSB0")
    yield made
    made.pull_out()


async def until(so: Callable[[], object]) -> None:
    async for _ in ticks(asyncio.get_running_loop().time(), 0.01):
        if so():
            return


def test_the_form_is_a_device_and_a_rate() -> None:
    endpoint = parse_endpoint("serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0:115200")
    assert endpoint == Endpoint(Kind.SERIAL, "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0", 115200)
    assert parse_endpoint(str(endpoint)) == endpoint


@pytest.mark.parametrize("rate", [0, 1, 57601, 9999999])
def test_a_rate_that_the_system_does_not_have_is_refused_with_those_it_has(rate: int) -> None:
    with pytest.raises(LinkError, match=rf"serial:/dev/x:{rate}: no rate of this system; accepted: .*57600, 115200"):
        parse_endpoint(f"serial:/dev/x:{rate}")


def test_a_vehicle_behind_a_radio_is_heard_and_told(plug: Plug) -> None:
    async def main() -> None:
        router = await Router.open({MAIN: [plug.endpoint]})
        beating = asyncio.ensure_future(router.keep_alive())
        vehicle = Sender(7, 1)
        frame = vehicle.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3))
        for piece in (b"\n\nBooting\r\n", frame[:5], frame[5:], bytes(range(256))):  # every byte passes as it is
            os.write(plug.vehicle, piece)
            await asyncio.sleep(0.05)
        address = VehicleAddress(MAIN, 7)
        await until(lambda: address in router.vehicles)
        assert router.endpoint_of(address) == str(plug.endpoint)
        router.send_message(address, dialect.MAVLink_ping_message(2**40, 13, 7, 1))
        codec, heard = Codec(), list[str]()

        def both() -> bool:
            heard.extend(message.get_type() for message in codec.receive(plug.heard()))
            return {"PING", "HEARTBEAT"} <= set(heard)

        await until(both)
        assert codec.bad_bytes == 0
        beating.cancel()
        router.close()

    fast(main)


def test_a_device_that_takes_nothing_gets_whole_frames_and_none_that_is_old(plug: Plug) -> None:
    async def main() -> None:
        wire, sender = await open_wire(plug.endpoint, lambda *_: None), Sender()
        for _ in range(5000):  # far more than the system's own buffers hold
            wire.send(sender.pack(heartbeat()), (str(plug.path), BAUD))
        assert wire.dropped > 0
        codec, frames = Codec(), list[int]()

        def quiet() -> bool:
            data = plug.heard()
            frames.extend(frame.get_seq() for frame in codec.receive(data))
            return not data

        await until(quiet)
        assert codec.bad_bytes == 0
        assert frames
        assert wire.dropped + len(frames) <= 5000
        wire.close()
        wire.close()

    fast(main)


def test_a_device_that_is_pulled_out_is_opened_again_when_it_is_back(plug: Plug) -> None:
    async def main() -> None:
        heard, changes = list[bytes](), list[Change]()

        def on_data(wire: Wire, address: Address, data: bytes) -> None:
            heard.append(data)

        wire = await open_wire(plug.endpoint, on_data, lambda _, change: changes.append(change))
        for _ in range(2):
            changes.clear()
            plug.pull_out()
            await until(lambda: changes)
            wire.send(b"nobody", (str(plug.path), BAUD))
            plug.plug_in()
            await until(lambda: len(changes) == 2)
            assert changes == [Change.LOST, Change.BACK]
            os.write(plug.vehicle, b"hello")
            await until(lambda: b"".join(heard).endswith(b"hello"))
            assert plug.heard() == b""
        assert wire.dropped == 2
        wire.close()

    fast(main)


def test_what_is_no_device_is_refused_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for path, said in ((tmp_path / "none", "No such file or directory"), (file, "not a serial device")):
        with pytest.raises(LinkError, match=f"serial:{path}:{BAUD}: {said}"):
            fast(partial(open_wire, Endpoint(Kind.SERIAL, str(path), BAUD), lambda *_: None))
