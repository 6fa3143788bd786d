import time

from fg_gcs.experiment.record_bench import BUDGET, record_bench


def test_recording_takes_a_small_share_of_a_core() -> None:
    found = record_bench(time.process_time, vehicles=9, flight_s=4.0)
    assert found.frames_hz == 9 * (50 + 25 + 25)
    assert found.bytes_s > 9 * (50 * 112 + 25 * 100)
    assert 0.0 < found.share < BUDGET
