from pathlib import Path

from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from fg_gcs.record.write.tlog import stamped

EPOCH_S = 1_700_000_000.0


def frames(count: int) -> list[bytes]:
    made = []
    for k in range(count):
        packer = common.MAVLink(None, srcSystem=k % 5 + 1, srcComponent=1)
        packer.seq = k % 256
        message = packer.heartbeat_encode(2, 12, 1, k, 3) if k % 2 else packer.attitude_encode(k, 0, 0, k / 10, 0, 0, 0)
        made.append(bytes(message.pack(packer)))
    return made


def test_other_programs_read_every_frame_with_its_time(tmp_path: Path) -> None:
    path, wanted = tmp_path / "flight.tlog", frames(40)
    times = [0.025 * k for k in range(len(wanted))]
    log = [stamped([frame], EPOCH_S + time_s) for frame, time_s in zip(wanted, times, strict=True)]
    path.write_bytes(b"".join(log))
    reader = mavutil.mavlink_connection(str(path), dialect="common")
    try:
        read = []
        while (message := reader.recv_msg()) is not None:
            read.append((bytes(message.get_msgbuf()), round(reader.timestamp - EPOCH_S, 6)))
    finally:
        reader.close()
    assert [frame for frame, _ in read] == wanted
    assert [stamp for _, stamp in read] == [round(time_s, 6) for time_s in times]


def test_a_record_is_its_stamp_and_its_frame() -> None:
    stamp = int((EPOCH_S + 1.5) * 1e6).to_bytes(8, "big")
    assert stamped([b"\xfdabc"], EPOCH_S + 1.5) == stamp + b"\xfdabc"
    assert stamped([b"\xfda", b"\xfdbc"], EPOCH_S + 1.5) == stamp + b"\xfda" + stamp + b"\xfdbc"
    assert stamped([], EPOCH_S + 1.5) == b""
