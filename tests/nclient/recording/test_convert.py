"""Conversion of drives: round trips through every format, and the readers of mcap, rosbags and evo."""

from __future__ import annotations

import contextlib
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

from localization.live.sensor_input import read_log
from nclient import connect
from nclient.cli.main import main
from nclient.errors import AddressError, ExtraMissing, LogFileError, RecordingError
from nclient.protocol.types import M_PER_IN, MODELS
from nclient.recording import convert
from nclient.recording.drive import RING, Drive, Sample
from nclient.recording.format import read_recording
from worlds.robots import N150

DATA = Path(__file__).parents[4] / "shared" / "data" / "sparse_gslam_flights"
FORMATS = (".log", ".mcap", ".bag", "", ".csv", ".clf")
# Formats that contain the whole recording besides the drive.
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
    # Tolerances of the format with the fewest decimals.
    assert len(found.samples) == len(wanted.samples)
    for one, other in zip(found.samples, wanted.samples, strict=True):
        assert one.time_s == pytest.approx(other.time_s, abs=1e-6)
        assert (one.x_m, one.y_m) == pytest.approx((other.x_m, other.y_m), abs=5e-6)
        turrets = [sample.heading_rad if sample.turret_rad is None else sample.turret_rad for sample in (one, other)]
        for angle, wanted_angle in ((one.heading_rad, other.heading_rad), turrets):
            # Angles modulo a full turn; a sample without a turret has it at the heading.
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
                # Times in eighths of a second, which are exact in binary and in decimal numbers.
                (k + 1) / 8, rng.uniform(-90, 90), rng.uniform(-90, 90), rng.uniform(-3.1, 3.1), rng.uniform(-3.1, 3.1),
                rng.uniform(-1, 1), rng.uniform(-1, 1),
                tuple(rng.choice((math.inf, rng.uniform(0.16, 6.4))) for _ in directions), rng.randrange(2**20),
            )
            for k in range(count)
        ], directions if sonars != 16 else RING, rng.choice((0.0, 0.25)))  # fmt: skip

    return st.builds(drive, st.integers(0, 2**32), st.integers(1, 5), st.sampled_from((1, 8, 16, 24)))


@settings(max_examples=8, deadline=None)
@given(drives(), st.sampled_from([suffix for suffix in FORMATS if suffix != ".log"]))
def test_drives_survive_every_format(drive: Drive, suffix: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"drive{suffix}"
        convert.write_drive(drive, path)
        found = convert.read_drive(path)
        the_same(found, drive, bumpers=suffix != ".clf")
        # A spreadsheet has no directions of the sonars.
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


@pytest.mark.long
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
    ring_m = N150.sonar_ring_radius_in * M_PER_IN
    # ROS measures from the centre of the robot, this project from the ring of sonars.
    assert scan.ranges.tolist() == pytest.approx([one + ring_m for one in sample.ranges_m])
    assert (scan.range_min, scan.range_max) == pytest.approx((6 * M_PER_IN + ring_m, 255 * M_PER_IN + ring_m))
    (frames,) = found["/tf_static"]
    # The fifth sonar of sixteen is 90 degrees to the left on the ring.
    assert frames.transforms[4].transform.translation.y == pytest.approx(ring_m)
    assert scan.angle_increment == pytest.approx(math.tau / 16)


@pytest.mark.long
@pytest.mark.parametrize("suffix", HOLD_RECORDINGS)
def test_readings_at_the_limits_survive(tmp_path: Path, suffix: str) -> None:
    """REP-117: -inf nearer than a sonar measures, +inf without an echo."""
    ranges = (6 * M_PER_IN, 7 * M_PER_IN, math.inf) + (math.inf,) * 13
    drive = Drive([Sample(1.0, ranges_m=ranges)], ring_m=0.25)
    (scan,) = [one.content for one in convert._ros()._messages(drive) if one.topic == "/robot1/sonar"]
    # 6 in is the shortest reading: a wall may be nearer, which REP-117 writes as -inf.
    assert scan["ranges"][:3] == [-math.inf, pytest.approx(7 * M_PER_IN + 0.25), math.inf]
    convert.write_drive(drive, tmp_path / f"run{suffix}")
    found = convert.read_drive(tmp_path / f"run{suffix}")
    assert found.samples[0].ranges_m == pytest.approx(ranges, abs=1e-6)
    assert found.ring_m == pytest.approx(0.25)


@pytest.mark.long
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
            # A recording holds tenths of an inch: half a tenth, and 0.001 for the conversion.
            assert state.x_in == pytest.approx(sample.x_m / M_PER_IN, abs=0.051)
            assert [one for one in state.sonars_in if one < 255] == [
                pytest.approx(range_m / M_PER_IN) for range_m in sample.ranges_m if range_m < math.inf
            ]
        robot.set_position(x_in=10, y_in=-5)
        robot.drive(translation_in_s=5)
        # A replayed drive reports the pose that the program sets, as a robot's encoders would.
        assert (robot.state.x_in, robot.state.y_in) == (10, -5)
        for _ in drive.samples[3:]:
            robot.refresh()
        with pytest.raises(RecordingError, match="ends"):
            robot.refresh()


def test_carmen_logs_of_lasers(tmp_path: Path) -> None:
    # Fields: number of readings, readings, pose of the laser, pose of the robot, time, host, time of the logger.
    text = ("PARAM robot_frontlaser_offset 0.1 nohost 0\n"
            "FLASER 3 1.0 2.0 81.0 5.1 6 0.5 5 6 0.5 1000.5 pc 0.5\n"
            "TRUEPOS 1 2 3 1 2 3 1000.6 pc 0.6\n"
            "FLASER 3 1.5 2.5 81.0 5.2 6 0.5 5.1 6 0.5 1001.5 pc 1.5\n")
    (tmp_path / "log.clf").write_text(text)
    drive = convert.read_drive(tmp_path / "log.clf")
    assert [(sample.time_s, sample.x_m) for sample in drive.samples] == [(0.5, 5), (1.5, 5.1)]
    assert drive.directions_rad == pytest.approx((-math.pi / 2, 0, math.pi / 2))
    # 1000.5 on the machine's clock is 0.5 on the logger's: the drive starts at 1000.
    assert drive.start_s == 1000
    assert drive.omitted == ["1 messages TRUEPOS"]
    convert.write_drive(drive, tmp_path / "log.log")
    assert any("ring of 3" in one for one in drive.omitted)
    (entry,) = [entry for entry in read_recording(tmp_path / "log.log").entries if entry.time_s == 1.5][-1].decoded
    # 2.5 m in front are 98 in, 81 m to the left are beyond 255 in, 1.5 m to the right are 59 in; nothing measures
    # behind.
    assert [entry["State"][17 + k] for k in (0, 4, 8, 12)] == [98, 255, 255, 59]


def write_bag(path: Path, *messages: tuple[str, Any]) -> None:
    """Write a ROS 1 bag of messages, one in each second of the type store of `ros_types`."""
    store = ros_types()
    with rosbag1.Writer(path) as bag:
        topics: dict[str, Any] = {}
        for second, (topic, message) in enumerate(messages, 1):
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=store)
            # Times of a ROS 1 bag are nanoseconds.
            bag.write(topics[topic], second * 10**9, store.serialize_ros1(message, message.__msgtype__))


def ros_types() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC)


def pose_of(x_m: float) -> Any:
    types = ros_types().types
    point = types["geometry_msgs/msg/Point"](x_m, 0.0, 0.0)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return types["geometry_msgs/msg/PoseStamped"](header_of(), types["geometry_msgs/msg/Pose"](point, turn))


def header_of() -> Any:
    types = ros_types().types
    return types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](0, 0), "base")


def scan_of(*ranges: float, first: float = 0.0) -> Any:
    found = np.array(ranges, np.float32)
    return ros_types().types["sensor_msgs/msg/LaserScan"](
        header_of(), first, 0.0, 0.5, 0.0, 0.0, 0.1, 80.0, found, np.array([], np.float32))


def battery_of(volts: float, place: str) -> Any:
    message = convert._ros().ros_messages.battery(0, "base", volts, place)
    return convert._ros()._builder(ros_types()).build("sensor_msgs/msg/BatteryState", message)


def test_one_topic_of_each_kind_is_read(tmp_path: Path) -> None:
    """Two robots and two lasers are not mixed; what is left out has a name."""
    types = ros_types().types
    charge = battery_of(12.0, "left")
    sonar = types["sensor_msgs/msg/Range"](header_of(), 0, 0.4, 0.1, 6.0, 1.5)
    write_bag(tmp_path / "two.bag", ("/a/pose", pose_of(1)), ("/b/pose", pose_of(9)), ("/battery", charge),
              ("/other/battery", battery_of(24.0, "right")),
              ("/front", scan_of(1, 2)), ("/rear", scan_of(3, 4, 5)), ("/front", scan_of(2, 3, 4)), ("/range", sonar))
    drive = convert.read_drive(tmp_path / "two.bag")
    # One pose, one scan: the first topic of each kind, and scans whose size does not change.
    assert [(sample.x_m, sample.ranges_m) for sample in drive.samples] == [(1, (1, 2))]
    left_out = [one.split()[0] for one in drive.omitted]
    assert left_out == ["/b/pose", "/battery", "/other/battery", "/rear", "/range", "1"]


def test_long_ranges_and_unequal_angles_in_bags(tmp_path: Path) -> None:
    drive = Drive([Sample(1.0, ranges_m=(50.0, 2.0, math.inf))], (-0.5, 0.0, 0.5))
    convert.write_drive(drive, tmp_path / "laser.bag")
    assert convert.read_drive(tmp_path / "laser.bag").samples[0].ranges_m == (50, 2, math.inf)
    convert.write_drive(drive, tmp_path / "laser.log")
    # State has a byte for each sonar: 50 m are beyond it.
    assert any("beyond 255" in one for one in drive.omitted)
    uneven = Drive([Sample(1.0, ranges_m=(1.0, 2.0, 3.0))], (0.0, 0.1, 2.0))
    convert.write_drive(uneven, tmp_path / "uneven.mcap")
    # A LaserScan has one increment for all its readings.
    assert [one for one in uneven.omitted if "equal angles" in one]
    assert convert.read_drive(tmp_path / "uneven.mcap").samples[0].ranges_m == ()


@pytest.mark.long
@pytest.mark.parametrize("suffix", HOLD_RECORDINGS)
def test_recording_cut_short_survives(recorded: Path, tmp_path: Path, suffix: str) -> None:
    """After a power failure the last line is not whole; it must not break the file that it is converted to."""
    # 50 bytes are less than a line: the last one is incomplete.
    (tmp_path / "cut.log").write_bytes(recorded.read_bytes()[:-50])
    drive = convert.read_drive(tmp_path / "cut.log")
    assert any("cut short" in one for one in drive.omitted)
    convert.write_drive(drive, tmp_path / f"cut{suffix}")
    assert convert.read_drive(tmp_path / f"cut{suffix}").samples == drive.samples


@pytest.mark.long
def test_mcap_of_any_name(recorded: Path, tmp_path: Path) -> None:
    convert.write_drive(convert.read_drive(recorded), tmp_path / "run.mcap")
    (tmp_path / "run.mcap").rename(tmp_path / "run.data")
    assert convert.read_drive(tmp_path / "run.data").samples
    convert.write_drive(convert.read_drive(recorded), tmp_path / "run.bag")
    (tmp_path / "run.bag").rename(tmp_path / "bag.data")
    with pytest.raises(RecordingError, match="ends in"):
        convert.read_drive(tmp_path / "bag.data")


@pytest.mark.parametrize(("field", "word"), [
    ("x_m=/a/pos:pose.position.x", "did you mean /a/pose"),
    ("x_m=/a/pose:header.frame_id", "is no number"),
    ("x_m=/a/pose:pose", "is no number"),
    ("x_m=/a/pose:pose.nothing", "has no pose.nothing"),
])  # fmt: skip
def test_fields_that_a_bag_does_not_have(tmp_path: Path, field: str, word: str) -> None:
    write_bag(tmp_path / "one.bag", ("/a/pose", pose_of(1)))
    with pytest.raises(RecordingError, match=word):
        convert.read_drive(tmp_path / "one.bag", [field])


def test_scans_before_the_first_pose_are_left_out(tmp_path: Path) -> None:
    """Also with --field: a scan without a pose is not one at the origin."""
    write_bag(tmp_path / "one.bag", ("/scan", scan_of(1, 2)), ("/pose", pose_of(7)), ("/scan", scan_of(3, 4)))
    fields = ["x_m=/pose:pose.position.x", "sonar_0_m=/scan:ranges.0"]
    for one in ([], fields):
        drive = convert.read_drive(tmp_path / "one.bag", one)
        assert [(sample.x_m, sample.ranges_m[0]) for sample in drive.samples] == [(7, 3)]
        assert "1 scans before the first pose" in drive.omitted


def test_spreadsheets_and_small_numbers(tmp_path: Path) -> None:
    # With a byte order mark, as spreadsheets write it, and a small number that would be printed as -9e-05.
    (tmp_path / "a.csv").write_text("time_s,x_in,y_in,heading_deg,sonar_0_in\n1.5,-0.00009,2,90,inf\n", "utf-8-sig")
    drive = convert.read_drive(tmp_path / "a.csv")
    assert (drive.samples[0].time_s, drive.samples[0].ranges_m) == (1.5, (math.inf,))
    assert list(convert.csv_lines(drive))[1].split(",")[:3] == ["1.5", "-0.0001", "2"]


@pytest.mark.parametrize(("text", "word"), [
    ("time_s,x_in,y_in,heading_deg\n0,nan,0,0\n", "row 2"),
    ("time_s,x_in,y_in,heading_deg,bumpers\n0,0,0,0,inf\n", "row 2"),
    ("time_s,x_in,y_in,heading_deg\n0,1e300,0,0\n", "sample 1"),
    ("time_s,x_in,y_in,heading_deg\n1e30,0,0,0\n", "sample 1"),
    ("time_s,x_in,x_m,y_in,heading_deg\n0,0,0,0,0\n", "2 times"),
    ("time_s,x_in,y_in,heading_deg,sonar_0_in,sonar_2_in\n0,0,0,0,1,2\n", "sonar_1"),
    (f"time_s,x_in,y_in,heading_deg\n0,0,0,{'1' * 200_000}\n", "no CSV"),
    ("ODOM 1 2 0 0 0 0 1e400 pc 0\n", "starts at"),
    ("ODOM 1 2 nan 0 0 0 0 pc 0\n", "sample 1"),
    ("SONAR 0.4 inf 1 0 0 0 0 pc 0\n", "line 1"),
    ("ODOM 0 0 0 0 0 0 0 pc 0\nSONAR 0.4 1 2 0 0 0 0 pc 0\nSONAR 0.4 2 1 1 0 0 0 0 0 1 0 pc 0\n", "2 sonars"),
])  # fmt: skip
def test_damaged_text_is_an_error_of_a_recording(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "log").write_text(text)
    with pytest.raises(RecordingError, match=word):
        convert.read_drive(tmp_path / "log")


def test_names_in_a_file_do_not_reach_the_terminal_raw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # An escape sequence in the name of a message, and 500 different names.
    lines = ["ODOM 0 0 0 0 0 0 0 pc 0", *(f"EVIL\x1b[31m{k} 0" for k in range(500))]
    (tmp_path / "a.clf").write_text("\n".join(lines) + "\n")
    assert main(["convert", str(tmp_path / "a.clf"), str(tmp_path / "a.csv")]) == 0
    shown = capsys.readouterr().err
    assert "\x1b" not in shown
    assert "480 messages of other kinds" in shown
    assert len(shown.splitlines()) < 30


def test_times_that_a_bag_cannot_hold(tmp_path: Path) -> None:
    for suffix in HOLD_RECORDINGS:
        with pytest.raises(RecordingError, match="cannot be written"):
            convert.write_drive(Drive([Sample(-5.0)]), tmp_path / f"early{suffix}")
        assert not (tmp_path / f"early{suffix}").exists()


def test_random_damage_is_an_error_of_a_recording(recorded: Path, tmp_path: Path) -> None:
    rng = Random(1)
    for suffix in (".mcap", ".bag", ".clf", ".csv"):
        path = tmp_path / f"run{suffix}"
        convert.write_drive(convert.read_drive(recorded), path)
        whole = path.read_bytes()
        for _ in range(25):
            data = bytearray(whole)
            # Eight wrong bytes in each of 25 copies; half of the copies are cut off as well.
            for _ in range(8):
                data[rng.randrange(len(data))] = rng.randrange(256)
            path.write_bytes(data[: rng.choice((len(data), rng.randrange(len(data))))])
            # Any other exception is a failure: a reader of files must not end with a traceback.
            with contextlib.suppress(RecordingError):
                convert.read_drive(path)


@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not here")
def test_flights_of_a_drone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, pose, ranges = str(DATA / "rice.bag"), "/crazyflie2/state_xyzv", "/crazyflie2/state_ranger_qxyzw"
    assert main(["convert", bag, str(tmp_path / "x.csv")]) == 1
    assert f"{pose} (infrastructure/msg/RawData)" in capsys.readouterr().err
    fields = {"x_m": f"{pose}:raw.0", "y_m": f"{pose}:raw.1", "qz": f"{ranges}:raw.7", "qw": f"{ranges}:raw.8"}
    # Front, left, back, right.
    fields |= {f"sonar_{k}_m": f"{ranges}:raw.{place}" for k, place in enumerate((1, 2, 3, 0))}
    words = [word for column, source in fields.items() for word in ("--field", f"{column}={source}")]
    assert main(["convert", bag, str(tmp_path / "x.csv"), *words]) == 0
    rows = read_log(tmp_path / "x.csv")
    assert (len(rows), round(rows[-1].clock_s, 1)) == (3150, 314.7)
    assert rows[0].sonars_in == pytest.approx([one / 0.0254 for one in (0.224, 1.899, 0.246, 0.541)], abs=1e-3)


def test_errors_name_file_and_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_text("hello")
    (tmp_path / "b.csv").write_text("time_s,x_in\n0,1\n")
    (tmp_path / "c.clf").write_text("ODOM 1 2 three 0 0 0 0 pc 0\n")
    for name, word in (("a.txt", "no recording"), ("b.csv", "row 2"), ("c.clf", "line 1"), ("d.log", "cannot be read")):
        with pytest.raises(RecordingError, match=word):
            convert.read_drive(tmp_path / name)
    with pytest.raises(RecordingError, match="suffix"):
        convert.format_to_write(tmp_path / "run.xyz")
    # The right magic number, and nothing that belongs behind it.
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n rubbish")
    with pytest.raises(RecordingError, match="cannot be read"):
        convert.read_drive(tmp_path / "run.mcap")
    with pytest.raises(LogFileError):
        read_log(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="exists"):
        convert.write_drive(Drive([Sample(0.0)]), tmp_path / "run.mcap")
    with pytest.raises((RecordingError, AddressError)):
        connect(f"replay:{tmp_path / 'run.mcap'}")
    # As if the extra with rosbags and mcap were not installed.
    monkeypatch.setitem(__import__("sys").modules, "nclient.recording.ros", None)
    monkeypatch.delattr("nclient.recording.ros", raising=False)
    with pytest.raises(ExtraMissing, match="ros"):
        convert.read_drive(tmp_path / "run.mcap")
