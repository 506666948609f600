"""Conversion of drives: round trips through every format, and the readers of mcap, rosbags and evo."""

from __future__ import annotations

import math
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader

from localization.live.log import read_log
from nclient import connect
from nclient.cli.main import main
from nclient.errors import AddressError, ExtraMissing, LogFileError, RecordingError
from nclient.protocol.types import M_PER_IN, MODELS
from nclient.recording import convert
from nclient.recording.drive import RING, Drive, Sample
from nclient.recording.format import read_recording

DATA = Path(__file__).parents[4] / "shared" / "data" / "sparse_gslam_flights"
FORMATS = (".log", ".mcap", ".bag", "", ".csv", ".clf")
HOLD_RECORDINGS = (".mcap", ".bag", "")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a short drive with sonars, a turn and a bumper."""
    path = tmp_path_factory.mktemp("drive") / "run.log"
    with connect(f"sim:thesis_room?seed=1&noisy=1&start=20,20,30,50&record={path}") as robot:
        robot.drive(translation_in_s=5, steering_deg_s=10, turret_deg_s=-7)
        for _ in range(20):
            robot.refresh()
    return path


def the_same(found: Drive, wanted: Drive, *, velocities: bool = True, bumpers: bool = True) -> None:
    assert len(found.samples) == len(wanted.samples)
    for one, other in zip(found.samples, wanted.samples, strict=True):
        assert one.time_s == pytest.approx(other.time_s, abs=1e-6)
        assert (one.x_m, one.y_m) == pytest.approx((other.x_m, other.y_m), abs=5e-6)
        turrets = [sample.heading_rad if sample.turret_rad is None else sample.turret_rad for sample in (one, other)]
        for angle, wanted_angle in ((one.heading_rad, other.heading_rad), turrets):
            assert math.remainder(angle - wanted_angle, math.tau) == pytest.approx(0, abs=2e-6)
        assert one.ranges_m == pytest.approx(other.ranges_m, rel=1e-6, abs=2e-6)
        if velocities:
            assert (one.speed_m_s, one.turn_rad_s) == pytest.approx((other.speed_m_s, other.turn_rad_s), abs=2e-6)
        if bumpers:
            assert one.bumpers == other.bumpers


@pytest.mark.parametrize("suffix", HOLD_RECORDINGS)
def test_recordings_come_back_to_the_byte(recorded: Path, tmp_path: Path, suffix: str) -> None:
    there, back = tmp_path / f"run{suffix}", tmp_path / "back.log"
    assert main(["convert", str(recorded), str(there)]) == 0
    assert main(["convert", str(there), str(back)]) == 0
    assert back.read_bytes() == recorded.read_bytes()


def drives() -> st.SearchStrategy[Drive]:
    def drive(seed: int, count: int, sonars: int) -> Drive:
        rng = Random(seed)
        directions = tuple(math.tau * k / sonars for k in range(sonars))
        return Drive([
            Sample(
                (k + 1) / 8, rng.uniform(-90, 90), rng.uniform(-90, 90), rng.uniform(-3.1, 3.1), rng.uniform(-3.1, 3.1),
                rng.uniform(-1, 1), rng.uniform(-1, 1),
                tuple(rng.choice((math.inf, rng.uniform(0.16, 6.4))) for _ in directions), rng.randrange(2**20),
            )
            for k in range(count)
        ], directions if sonars != 16 else RING)  # fmt: skip

    return st.builds(drive, st.integers(0, 2**32), st.integers(1, 5), st.sampled_from((1, 8, 16, 24)))


@settings(max_examples=8, deadline=None)
@given(drives(), st.sampled_from([suffix for suffix in FORMATS if suffix != ".log"]))
def test_drives_survive_every_format(drive: Drive, suffix: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"drive{suffix}"
        convert.write_drive(drive, path)
        found = convert.read_drive(path)
        the_same(found, drive, bumpers=suffix != ".clf")
        if suffix != ".csv":
            assert found.directions_rad == pytest.approx(drive.directions_rad, abs=1e-5)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(sorted(MODELS)))
def test_whole_units_survive_a_recording(seed: int, model: str) -> None:
    """A recording holds tenths of inches and degrees, and whole inches of sonars."""
    rng = Random(seed)
    tenth, degree = M_PER_IN / 10, math.radians(0.1)
    turn = 0.0 if model == "scout" else rng.randrange(-450, 450) * degree  # a Scout has velocities of its wheels
    samples = [
        Sample(k / 8, rng.randrange(-9999, 9999) * tenth, rng.randrange(-9999, 9999) * tenth,
               rng.randrange(3600) * degree, rng.randrange(3600) * degree, rng.randrange(-200, 200) * tenth, turn,
               tuple(rng.choice((math.inf, rng.randrange(6, 255) * M_PER_IN)) for _ in RING), rng.randrange(2**20))
        for k in range(1, 4)
    ]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.log"
        convert.write_drive(Drive(samples, model=MODELS[model]), path)
        the_same(convert.read_drive(path), Drive(samples))


def test_mcap_holds_ros_messages(recorded: Path, tmp_path: Path) -> None:
    """The reader of mcap finds schemas and channels, rosbags' CDR the values."""
    from rosbags.typesys import Stores, get_typestore

    drive = convert.read_drive(recorded)
    convert.write_drive(drive, tmp_path / "run.mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[str, list[Any]] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            found.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name))
    odometry, scan, sample = found["/robot1/odom"][-1], found["/robot1/sonar"][-1], drive.samples[-1]
    assert len(found["/robot1/odom"]) == len(found["/tf"]) == len(drive.samples)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("robot1/odom", "robot1/base_link")
    assert odometry.pose.pose.position.x == sample.x_m
    assert scan.header.frame_id == "robot1/turret"
    assert np.array_equal(scan.ranges, np.array(sample.ranges_m, np.float32))
    assert scan.angle_increment == pytest.approx(math.tau / 16)


@pytest.mark.parametrize("suffix", [".bag", ""])
def test_rosbags_and_evo_read_bags(recorded: Path, tmp_path: Path, suffix: str) -> None:
    from evo.tools.file_interface import read_bag_trajectory

    drive, path = convert.read_drive(recorded), tmp_path / f"run{suffix}"
    convert.write_drive(drive, path)
    with AnyReader([path]) as reader:
        assert reader.topics["/robot1/sonar"].msgtype == "sensor_msgs/msg/LaserScan"
    with (rosbag1.Reader if suffix else rosbag2.Reader)(path) as bag:
        path_of_evo = read_bag_trajectory(bag, "/robot1/odom")
    assert path_of_evo.positions_xyz[:, 0] == pytest.approx([sample.x_m for sample in drive.samples])
    assert np.diff(path_of_evo.timestamps) == pytest.approx(np.diff([sample.time_s for sample in drive.samples]))


def test_localizer_reads_all_formats(recorded: Path, tmp_path: Path) -> None:
    rows = read_log(recorded)
    for suffix in FORMATS:
        path = tmp_path / f"run{suffix}"
        convert.write_drive(convert.read_drive(recorded), path)
        found = read_log(path)
        for one, other in zip(found, rows, strict=True):
            assert one.odometry[:2] == pytest.approx(other.odometry[:2], abs=1e-4)
            assert math.remainder(one.turret_rad - other.turret_rad, math.tau) == pytest.approx(0, abs=1e-5)
            assert one.sonars_in == pytest.approx(other.sonars_in, abs=1e-4)


def test_drives_of_others_replay_as_robots(recorded: Path, tmp_path: Path) -> None:
    drive = convert.read_drive(recorded)
    convert.write_drive(Drive(drive.samples), tmp_path / "run.bag")
    with connect(f"replay:{tmp_path / 'run.bag'}") as robot:
        for sample in drive.samples[:3]:
            state = robot.refresh()
            assert state.x_in == pytest.approx(sample.x_m / M_PER_IN, abs=0.051)
            assert [one for one in state.sonars_in if one < 255] == [
                pytest.approx(range_m / M_PER_IN) for range_m in sample.ranges_m if range_m < math.inf
            ]
        robot.set_position(x_in=10, y_in=-5)
        robot.drive(translation_in_s=5)
        assert (robot.state.x_in, robot.state.y_in) == (10, -5)
        for _ in drive.samples[3:]:
            robot.refresh()
        with pytest.raises(RecordingError, match="ends"):
            robot.refresh()


def test_carmen_logs_of_lasers(tmp_path: Path) -> None:
    text = ("PARAM robot_frontlaser_offset 0.1 nohost 0\n"
            "FLASER 3 1.0 2.0 81.0 5.1 6 0.5 5 6 0.5 1000.5 pc 0.5\n"
            "TRUEPOS 1 2 3 1 2 3 1000.6 pc 0.6\n"
            "FLASER 3 1.5 2.5 81.0 5.2 6 0.5 5.1 6 0.5 1001.5 pc 1.5\n")
    (tmp_path / "log.clf").write_text(text)
    drive = convert.read_drive(tmp_path / "log.clf")
    assert [(sample.time_s, sample.x_m) for sample in drive.samples] == [(0.5, 5), (1.5, 5.1)]
    assert drive.directions_rad == pytest.approx((-math.pi / 2, 0, math.pi / 2))
    assert drive.start_s == 1000
    assert drive.omitted == ["1 messages TRUEPOS"]
    convert.write_drive(drive, tmp_path / "log.log")
    assert any("ring of 3" in one for one in drive.omitted)
    (entry,) = [entry for entry in read_recording(tmp_path / "log.log").entries if entry.time_s == 1.5][-1].decoded
    assert [entry["State"][17 + k] for k in (0, 4, 8, 12)] == [98, 255, 255, 59]


@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not here")
def test_flights_of_a_drone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, pose, ranges = str(DATA / "rice.bag"), "/crazyflie2/state_xyzv", "/crazyflie2/state_ranger_qxyzw"
    assert main(["convert", bag, str(tmp_path / "x.csv")]) == 1
    assert f"{pose} (infrastructure/msg/RawData)" in capsys.readouterr().err
    fields = {"x_m": f"{pose}:raw.0", "y_m": f"{pose}:raw.1", "qz": f"{ranges}:raw.7", "qw": f"{ranges}:raw.8"}
    fields |= {f"sonar_{k}_m": f"{ranges}:raw.{place}" for k, place in enumerate((0, 2, 1, 3))}
    words = [word for column, source in fields.items() for word in ("--field", f"{column}={source}")]
    assert main(["convert", bag, str(tmp_path / "x.csv"), *words]) == 0
    rows = read_log(tmp_path / "x.csv")
    assert (len(rows), round(rows[-1].clock_s, 1)) == (3150, 314.7)
    assert rows[0].sonars_in == pytest.approx([one / 0.0254 for one in (0.541, 1.899, 0.224, 0.246)], abs=1e-3)


def test_errors_name_file_and_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_text("hello")
    (tmp_path / "b.csv").write_text("time_s,x_in\n0,1\n")
    (tmp_path / "c.clf").write_text("ODOM 1 2 three 0 0 0 0 pc 0\n")
    for name, word in (("a.txt", "no recording"), ("b.csv", "row 2"), ("c.clf", "line 1"), ("d.log", "cannot be read")):
        with pytest.raises(RecordingError, match=word):
            convert.read_drive(tmp_path / name)
    with pytest.raises(RecordingError, match="suffix"):
        convert.format_to_write(tmp_path / "run.xyz")
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n rubbish")
    with pytest.raises(RecordingError, match="cannot be read"):
        convert.read_drive(tmp_path / "run.mcap")
    with pytest.raises(LogFileError):
        read_log(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="exists"):
        convert.write_drive(Drive([Sample(0.0)]), tmp_path / "run.mcap")
    with pytest.raises((RecordingError, AddressError)):
        connect(f"replay:{tmp_path / 'run.mcap'}")
    monkeypatch.setitem(__import__("sys").modules, "nclient.recording.ros", None)
    monkeypatch.delattr("nclient.recording.ros", raising=False)
    with pytest.raises(ExtraMissing, match="ros"):
        convert.read_drive(tmp_path / "run.mcap")
