"""Stamps in another unit than nanoseconds are named, and no others."""

import re
from pathlib import Path

import pytest

from holdfast.errors import RecordingError
from holdfast.recording.source import open_recording
from holdfast.recording.stamp_units import NS_PER_UNIT

EPOCH_NS = 1_700_000_000_000_000_000
S, MS = 1_000_000_000, 1_000_000


def write(folder: Path, imu: list[int], gnss: list[int], arrival_ns: int | None = None) -> None:
    """Write a file of an IMU and one of fixes, whose arrivals are their stamps or count units of so many ns."""
    head = "stamp_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"
    (folder / "imu.csv").write_text(head + "".join(f"{stamp},0,0,0,0,0,9.8\n" for stamp in imu))
    head = "stamp_ns,latitude_deg,longitude_deg,altitude_m,status,arrival_ns\n"
    rows = (f"{stamp},49,8,0,2,{stamp if arrival_ns is None else stamp // arrival_ns}\n" for stamp in gnss)
    (folder / "gnss.csv").write_text(head + "".join(rows))


def stamps(start_ns: int, step_ns: int, number: int, unit_ns: int = 1) -> list[int]:
    return [(start_ns + k * step_ns) // unit_ns for k in range(number)]


def faults(folder: Path) -> list[str]:
    with pytest.raises(RecordingError) as error:
        open_recording(folder)
    return str(error.value).split("\n")


@pytest.mark.parametrize("unit", NS_PER_UNIT)
def test_fixes_in_another_unit_beside_an_imu_in_nanoseconds_are_named(tmp_path: Path, unit: str) -> None:
    """The estimator said that the IMU had not measured without a gap."""
    ns = NS_PER_UNIT[unit]
    write(tmp_path, stamps(EPOCH_NS, 10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20, ns))
    assert faults(tmp_path) == [
        f"{tmp_path}/gnss.csv: stamp_ns and arrival_ns look like {unit}, from {EPOCH_NS // ns} to "
        f"{(EPOCH_NS + 3800 * MS) // ns}: must be nanoseconds, {ns:,} times as many"
    ]


@pytest.mark.parametrize("unit", NS_PER_UNIT)
def test_an_imu_in_another_unit_beside_fixes_in_nanoseconds_is_named(tmp_path: Path, unit: str) -> None:
    write(tmp_path, stamps(EPOCH_NS, 10 * MS, 400, NS_PER_UNIT[unit]), stamps(EPOCH_NS, 200 * MS, 20))
    (fault,) = faults(tmp_path)
    assert re.match(rf".*/imu\.csv: stamp_ns looks like {unit}, from ", fault)


@pytest.mark.parametrize("start_ns", [0, EPOCH_NS])
@pytest.mark.parametrize("unit", NS_PER_UNIT)
def test_a_folder_in_another_unit_is_named_by_the_pace_of_its_imu(tmp_path: Path, unit: str, start_ns: int) -> None:
    ns = NS_PER_UNIT[unit]
    write(tmp_path, stamps(start_ns, 10 * MS, 400, ns), stamps(start_ns, 200 * MS, 10, ns))
    (fault,) = faults(tmp_path)
    assert f"imu.csv: stamp_ns looks like {unit}" in fault


def test_an_imu_of_2_khz_in_microseconds_is_known_by_the_year(tmp_path: Path) -> None:
    write(tmp_path, stamps(EPOCH_NS, MS // 2, 400, 1000), stamps(EPOCH_NS, 200 * MS, 1, 1000))
    (fault,) = faults(tmp_path)
    assert "imu.csv: stamp_ns looks like microseconds" in fault


def test_arrivals_in_another_unit_than_their_stamps_are_named(tmp_path: Path) -> None:
    write(tmp_path, stamps(EPOCH_NS, 10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20), arrival_ns=1000)
    (fault,) = faults(tmp_path)
    assert "gnss.csv: arrival_ns looks like microseconds" in fault


@pytest.mark.parametrize(("imu", "gnss"), [
    (stamps(EPOCH_NS, 10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20)),
    (stamps(EPOCH_NS, MS // 4, 400), stamps(EPOCH_NS, 200 * MS, 20)),  # 4 kHz
    (stamps(2 * S, 10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20)),  # a clock that counts from the boot
    (stamps(2 * S, 10 * MS, 400), stamps(2 * S, 200 * MS, 20)),
    (stamps(20 * 86_400 * S, 10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20)),
    ([0] * 400, stamps(EPOCH_NS, 200 * MS, 20)),  # stamps that stand still
    (stamps(EPOCH_NS, -10 * MS, 400), stamps(EPOCH_NS, 200 * MS, 20)),
    ([5], [7]),
])  # fmt: skip
def test_stamps_in_nanoseconds_are_taken_whatever_their_clock(tmp_path: Path, imu: list[int], gnss: list[int]) -> None:
    write(tmp_path, imu, gnss)
    assert open_recording(tmp_path).start_ns == min(imu[0], gnss[0])


def test_a_file_without_lines_and_one_that_was_cut_off_are_left_to_who_reads_them(tmp_path: Path) -> None:
    write(tmp_path, stamps(EPOCH_NS, 10 * MS, 400), [])
    with (tmp_path / "imu.csv").open("a") as file:
        file.write("17000")
    assert open_recording(tmp_path).end_ns is None
