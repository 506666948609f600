"""`nomad map learn`: make a map of walls from a drive, recorded or live.

    --from RECORDING   read the drive -------------------------------+
    ADDRESS            drive and record, on the map as it grows --> read the recording --> learn --> files

A live drive is recorded, and the map that is written is learned from the recording: `--from` it gives the same map.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple
from urllib.parse import quote

from localization.cli import arguments
from localization.filters.belief import Floats
from localization.filters.sonar_cone import ConeSonar, building_sonar, cone_sonar
from localization.live.assumptions import (
    BUILDING_SETUP,
    resolve_body,
    resolve_robot_model,
    setup_of,
    sonar_model_of_address,
)
from localization.live.run import GroundTruth, Publisher
from localization.live.sensor_input import read_log, without_echo
from localization.mapping.association import MapEstimate
from localization.mapping.explore import Explorer
from localization.mapping.learn import LEVEL_ROUGHNESS_IN, ROUGHNESS_IN, MapLearner, learn_log
from localization.mapping.live import LiveMapper
from localization.mapping.measurements import DriveCollector, DriveLog, drive_of_rows, read_drive
from localization.mapping.output import LearnedMap, MapPublisher, describe, draw_learned, summary
from localization.mapping.problem import COMMON_OFFSET, PARAMETER_STDS
from localization.mapping.survey import Driver, Geofence, RobotMoved, SurveyLog, SurveyStep, WaypointDriver, survey
from localization.navigation.control_law import MODEL_LIMITS
from localization.plot import check_picture
from nclient import Robot
from nclient.common.arguments import add_value
from nclient.common.process import ExitCode, TerminatedBySignal, show_seconds
from nclient.connector import address_or_default
from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.recording import convert
from nclient.url import parse_address, split_address
from worlds.map_files import MapsExtraMissing
from worlds.rings import Ring
from worlds.robots import BODIES, Body, format_calibration

DRIVES = ("auto", "manual")
SONARS: Final[Mapping[str, Callable[[Ring], ConeSonar]]] = MappingProxyType(
    {"rays": cone_sonar, "cones": cone_sonar, BUILDING_SETUP: building_sonar}
)
"""Limits and noise of the readings by --sonars."""
PLANE_ROUGHNESS_IN = 0.8
"""Of walls of a building without levels: pieces of a real wall differ by 40 mm, doors stand back."""
PRINT_S = 5.0
"""Seconds of the robot's clock between two lines of progress."""
SPEED_IN_S = 9.0
TURN_RAD_S = 0.8
"""Slower than a robot can turn: a node stands for half a second."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map learn`."""
    parser.description = (
        "Make a map of the room by driving, without any map. The robot explores the room by itself or drives to "
        "waypoints, a person drives it (--drive manual), or a recorded drive is read (--from). Keep the emergency "
        "button at hand."
    )
    parser.epilog = (
        "example: nomad map learn 'sim:thesis_room?setup=measured&seed=1' --out room.toml"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    add_value(parser, "--calibration-out", "FILE", Path,
              "write sonar offsets and wheel scales into this model file, which --calibration reads")
    add_drive_arguments(parser)


def add_drive_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a drive, recorded or live, from which walls are learned."""
    parser.set_defaults(refuse=parser.error)
    parser.add_argument(
        "address", nargs="?", metavar="ADDRESS",
        help="robot to drive, such as nserver://localhost:7019/1, serial:///dev/ttyUSB0 or sim:thesis_room (default: "
        "$NOMAD_ROBOT, or robot 1 of a local nserver)",
    )  # fmt: skip
    parser.add_argument(
        "--from", dest="recording", nargs="+", type=Path, metavar="RECORDING",
        help="read this recording of a drive instead of driving; several are parts of one drive, in order; or one log "
             "of any robot: bag, MCAP or CARMEN log as nomad convert reads them, or CSV (page Real data of the manual)",
    )  # fmt: skip
    add_value(parser, "--picture", "PNG", Path, "draw the result into this file (needs the extra `plot`)")
    arguments.add_odometry_noise(parser)
    parser.add_argument(
        "--body", type=str.lower, metavar="NAME",
        help="with --from a log: the robot, a Nomad or one of --model-file (default: the last one there, else n150)",
    )
    parser.add_argument("--model-file", type=Path, metavar="FILE", help="with --from a log: robot models, their sonars")
    parser.add_argument(
        "--omnidirectional", action="store_true",
        help="with --from a log: the robot moves sideways as well, as drones do (default: along its heading only)",
    )
    add_value(parser, "--sonar-delay", "S", arguments.parse_seconds,
              "with --from a log: the readings in a row are older than its pose by this", 0.0)
    add_value(parser, "--scale-std", "A[,B[,C]]", arguments.parse_scales,
              "with --from: standard deviations of the odometry's systematic errors, which the map estimates: distance "
              f"scale, turn scale, drift in rad/in (default: {','.join(map(str, PARAMETER_STDS[:COMMON_OFFSET]))})", ())
    parser.add_argument(
        "--roughness", type=arguments.parse_positive, metavar="IN",
        help=f"standard deviation of walls from straight lines in inches (default: {ROUGHNESS_IN}; with --sonars "
             f"{BUILDING_SETUP} walls have levels instead, {LEVEL_ROUGHNESS_IN} rough, or {PLANE_ROUGHNESS_IN} if "
             "those make no map)",
    )  # fmt: skip
    parser.add_argument(
        "--sonars", choices=SONARS,
        help="sonar model: exact rays, the cones of a real ring, or the same in a real building, whose walls have "
             "doors and posts (default: for sim: addresses that of the setup, else cones)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print only the result, as JSON, on stdout")
    live = parser.add_argument_group("driving")
    live.add_argument(
        "--waypoints", nargs="+", type=arguments.parse_point, metavar="X,Y",
        help="drive to these positions in order, inches from the start, x ahead and y to the left; what is in the way "
        "ends a leg, and the next one follows (default: explore the room)",
    )  # fmt: skip
    live.add_argument("--drive", choices=DRIVES, default="auto",
                      help="manual: a person drives, from the page or nomad shell, until Ctrl-C or the time limit; "
                           "the robot gets no command (default: %(default)s)")  # fmt: skip
    add_value(live, "--record", "FILE", Path, "record the drive into this file (default: --out with the suffix .log)")
    live.add_argument(
        "--resume", nargs="+", type=Path, metavar="RECORDING",
        help="go on with the drive of these recordings: the robot must stand where it stood at their end, as its first "
             "readings are compared with the last ones there",
    )
    add_value(live, "--time-limit", "S", arguments.parse_positive,
              "end the drive after this many seconds of the robot's clock", 300.0)
    add_value(live, "--geofence", "X0,Y0,X1,Y1", parse_geofence,
              "keep the robot's axis within this rectangle, inches in the frame of --waypoints")
    add_value(live, "--speed", "IN_S", arguments.parse_positive, "top speed in inches per second", SPEED_IN_S)
    arguments.add_publish(live, "the map as it grows, uncertain walls dashed,")


def parse_geofence(text: str) -> Geofence:
    """Return the rectangle between two corners."""
    x0, y0, x1, y1 = arguments.parse_numbers(text, 4, ", inches, such as -40,-40,200,120")
    return Geofence((min(x0, x1), min(y0, y1)), (max(x0, x1), max(y0, y1)))


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code: 0; 3 if waypoints were left out; 4 if no map is written."""
    # 1. Report unwritable files before the work.
    arguments.check_writable(options.out, options.calibration_out)
    check_picture(options.picture)
    with page_of(options) as page:
        # 2. The drive.
        try:
            recordings, result = recordings_of(options, options.out, page)
        except RobotMoved as error:
            print(f"nomad map learn: no map written: {error}", file=sys.stderr)
            return ExitCode.UNFIT
        # 3. The map.
        learned = _learn(options, read_source(options, recordings), recordings, page)
    return result if learned is ExitCode.DONE else learned


@contextlib.contextmanager
def page_of(options: argparse.Namespace) -> Generator[MapPublisher | None, None, None]:
    """Open the page of --publish; without one, and for a recorded drive, there is none."""
    if not options.publish or options.recording is not None:
        yield None
        return
    with contextlib.closing(MapPublisher(Publisher(options.publish), time.monotonic)) as page:
        yield page


def recordings_of(
    options: argparse.Namespace, out: Path, page: MapPublisher | None
) -> tuple[list[Path], ExitCode]:
    """Return the recordings of --from, or those of a drive now, beside `out`; and how the drive ended."""
    if options.recording is None:
        address = address_or_default(options.address)
        if options.sonars is None and (setup_of(address) or {}).get("base") == BUILDING_SETUP:
            options.sonars = BUILDING_SETUP
        return _drive(options, out, page)
    if options.address or options.resume or options.waypoints or options.record or options.geofence or (
        options.drive != DRIVES[0]
    ):
        options.refuse(
            "--from reads a drive: omit the address, --resume, --waypoints, --record, --geofence and --drive manual"
        )
    return options.recording, ExitCode.DONE


class Source(NamedTuple):
    """A drive, with the robot and the sonars that measured it."""

    log: DriveLog
    body: Body
    sonar: ConeSonar


def read_source(options: argparse.Namespace, recordings: list[Path]) -> Source:
    """Read recordings of a Nomad, or the log of any robot.

    Raises
    ------
    LogFileError, RecordingError, WorldFileError
    """
    if options.recording is None or convert.is_recording(recordings[0]):
        if options.body or options.model_file or options.omnidirectional or options.sonar_delay:
            options.refuse(
                "--body, --model-file, --omnidirectional and --sonar-delay describe the robot of a log: a recording "
                "names its own"
            )
        log = read_drive(*recordings)
        return Source(log, BODIES[log.model], SONARS[options.sonars or "cones"](BODIES[log.model].ring))
    if len(recordings) > 1:
        options.refuse("--from several files: parts of a drive are recordings; of logs, give one")
    body = arguments.resolve_log_body(options)
    rows = without_echo(read_log(recordings[0]), body.ring)
    log = drive_of_rows(rows, body, is_omnidirectional=options.omnidirectional, delay_s=options.sonar_delay)
    return Source(log, body, SONARS[options.sonars or "cones"](body.ring))


def learn_drive(options: argparse.Namespace, source: Source) -> tuple[MapLearner, LearnedMap]:
    """Return the estimator of a drive, after its end, and the map.

    In a building, where --roughness does not say what walls are, they have levels. Walls that make no map that holds
    together are taken for planes, rough by PLANE_ROUGHNESS_IN; if those make none either, the map is that with levels.
    """
    by_default = options.roughness is None and options.sonars == BUILDING_SETUP
    found: list[tuple[MapLearner, LearnedMap]] = []
    for roughness_in in (options.roughness, PLANE_ROUGHNESS_IN) if by_default else (options.roughness,):
        learner = learn_log(
            source.log, options.odometry_noise, source.sonar, rays=has_rays(options), roughness_in=roughness_in,
            scale_stds=options.scale_std,
        )
        unexplored = _unexplored(learner.estimate, source.body)
        found.append((learner, describe(learner.estimate, learner.turret_rad, learner.rest, unexplored)))
        if not found[-1][1].reason_to_refuse():
            return found[-1]
    return found[0]


def _learn(options: argparse.Namespace, source: Source, recordings: list[Path], page: MapPublisher | None) -> ExitCode:
    """Learn the map of a drive, write the files and print the result."""
    with show_seconds("learning the map"):
        learner, found = learn_drive(options, source)
    # The picture also shows why a map is refused.
    if options.picture is not None:
        draw_learned(options.picture, found, learner.estimate)
    reason = found.reason_to_refuse()
    if not reason:
        _write_files(options, found, source.body.name, recordings)
    if page is not None:
        page.finish(learner.estimate, f"No map written: {reason}" if reason else f"Written to {options.out}.")
    print(json.dumps(found.as_json()) if options.json else summary(found))
    if reason:
        print(f"nomad map learn: no map written: {reason}", file=sys.stderr)
        return ExitCode.UNFIT
    return ExitCode.DONE


def _unexplored(estimate: MapEstimate, body: Body) -> Floats | None:
    """Return where the room goes on beyond the map; None without the extra that finds it."""
    with contextlib.suppress(MapsExtraMissing):
        return Explorer(body.radius_in, SPEED_IN_S, math.inf).unexplored(estimate)
    return None


def has_rays(options: argparse.Namespace) -> bool:
    """Return True if the sonars measure along exact rays."""
    if options.sonars is None and options.recording is None:
        return bool(sonar_model_of_address(address_or_default(options.address)))
    return bool(options.sonars == "rays")


# Driving.


def _drive(
    options: argparse.Namespace, out: Path, page: MapPublisher | None
) -> tuple[list[Path], ExitCode]:
    """Drive the robot and record it; return the recordings, those of --resume first, and the exit code."""
    _check_route(options)
    address, record = recorded_address(options, out)
    before = read_drive(*options.resume) if options.resume else None
    if options.resume and record.resolve() in [path.resolve() for path in options.resume]:
        options.refuse(f"{record} is one of --resume: name another file with --record")
    arguments.check_writable(record)
    robot, is_simulated = arguments.open_robot(address)
    if page is not None:
        page.ground_truth = GroundTruth(robot, is_simulated)
    with contextlib.ExitStack() as stack:
        # A robot that a person drives is not stopped.
        stack.callback(robot.disconnect) if options.drive == "manual" else stack.enter_context(robot)
        body = resolve_body(resolve_robot_model(None, robot.model.name, options.address), None, options.address)
        _require_nomad(body, robot.model.name)
        driver = _driver(options, body)
        try:
            last, log = _follow(robot, body, driver, before, options, page)
        except (KeyboardInterrupt, TerminatedBySignal, ConnectionLost, ReplyTimeout):
            again = " ".join(str(path) for path in [*(options.resume or []), record])
            print(f"nomad map {options.tool}: stopped; the drive is in {record}: --from {again} reads it, "
                  f"--resume {again} --record FILE goes on", file=sys.stderr, flush=True)  # fmt: skip
            raise
        if driver is not None:
            # The recording ends with the robot at rest.
            robot.wait_until_still()
            robot.refresh()
    result = _report(options, driver, last, log)
    print(f"the drive is in {record}", file=sys.stderr if options.json else sys.stdout, flush=True)
    return [*(options.resume or []), record], result


def _require_nomad(body: Body, model: str) -> None:
    """Raise AddressError for a body of a model file with other sonars: maps are learned with those of a Nomad."""
    if body.ring != BODIES[model].ring:
        raise AddressError(
            f"model_file= in the address describes other sonars than those of a {model}, and maps are learned with "
            "those alone: omit it"
        )


def _check_route(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    if options.drive == "manual" and options.waypoints:
        options.refuse("--drive manual: a person drives; omit --waypoints")
    points = options.waypoints or []
    if options.geofence is None:
        return
    outside = [point for point in points if not options.geofence.contains(*point)]
    if outside:
        options.refuse(f"waypoint {outside[0][0]:g},{outside[0][1]:g} is outside of --geofence")
    if not options.resume and not options.geofence.contains(0.0, 0.0):
        options.refuse("the robot's start 0,0 is outside of --geofence")


def _driver(options: argparse.Namespace, body: Body) -> Driver | None:
    """Return what chooses the route; None if a person drives."""
    if options.drive == "manual":
        return None
    if options.waypoints:
        return WaypointDriver(options.waypoints)
    return Explorer(body.radius_in, options.speed, options.time_limit, options.geofence)


def recorded_address(options: argparse.Namespace, out: Path) -> tuple[str, Path]:
    """Return the address with a recording and without reconnecting, and the file, by default beside `out`.

    A drive is one connection: after another one the sonars fire at other instants, and in the recording a second drive
    begins. So a lost link ends the drive; --resume goes on.
    """
    text = address_or_default(options.address)
    there, more = split_address(text).options, []
    # 1. The recording.
    record: Path = options.record or out.with_suffix(".log")
    if "record" in there:
        if options.record is not None:
            options.refuse("--record and record= in the address exclude each other: give one of them")
        record = Path(there["record"])
    else:
        more.append(f"record={quote(str(record))}")
    # 2. One connection.
    if parse_address(text).options.reconnect:
        if "reconnect" in there:
            options.refuse("reconnect= in the address: a drive is one connection; omit it, and go on with --resume")
        more.append("reconnect=0")
    return "&".join([f"{text}{'&' if '?' in text else '?'}{more[0]}", *more[1:]]) if more else text, record


def _follow(
    robot: Robot, body: Body, driver: Driver | None, before: DriveLog | None, options: argparse.Namespace,
    page: MapPublisher | None,
) -> tuple[SurveyStep, SurveyLog]:
    """Drive until the end and print progress; return the last period and the log."""
    rays = has_rays(options)

    def mapper_of(collector: DriveCollector) -> LiveMapper:
        return LiveMapper(
            collector, options.odometry_noise, SONARS[options.sonars or "cones"](body.ring), rays=rays,
            roughness_in=options.roughness,
        )

    limits = MODEL_LIMITS[robot.model.name].capped(options.speed, TURN_RAD_S)
    steps = survey(
        robot, body, mapper_of, driver, limits, robot.sleep, fence=options.geofence,
        collector=None if before is None else DriveCollector(robot.model.name, before),
    )  # fmt: skip
    # Closing the generator stops the robot.
    with contextlib.closing(steps):
        return _print_progress(steps, options, page, is_manual=driver is None)


def _print_progress(
    steps: Generator[tuple[SurveyStep, LiveMapper, SurveyLog], None, None], options: argparse.Namespace,
    page: MapPublisher | None, is_manual: bool,
) -> tuple[SurveyStep, SurveyLog]:
    printed_s, noted, last, log = -math.inf, 0, SurveyStep(0.0, None, None), SurveyLog()
    try:
        for step, mapper, log in steps:
            last = step
            if page is not None:
                page.add(step, mapper)
            if not options.json and step.elapsed_s >= printed_s + PRINT_S:
                printed_s = step.elapsed_s
                print(progress_line(step, mapper), flush=True)
            for clock_s, note in log.notes[noted:]:
                print(f"{clock_s:7.1f} s  {note}", file=sys.stderr if options.json else sys.stdout, flush=True)
            noted = len(log.notes)
            if step.elapsed_s > options.time_limit:
                return step._replace(ended=f"time limit: {options.time_limit:g} s (--time-limit)"), log
    except KeyboardInterrupt:
        # A person who has driven enough; anything else must stop the robot and leave the map alone.
        if not is_manual:
            raise
    return last, log


def progress_line(step: SurveyStep, mapper: LiveMapper) -> str:
    """Return time, pose, and the map so far as a line of text."""
    if step.pose is None:
        return f"{step.elapsed_s:7.1f} s  waiting for readings"
    x, y, heading = step.pose.tolist()
    estimate = mapper.estimate
    walls, points = (0, 0) if estimate is None else (len(estimate.state.walls), len(estimate.state.points))
    return (
        f"{step.elapsed_s:7.1f} s  ({x:6.1f}, {y:6.1f}) in {math.degrees(heading):5.0f} deg  "
        f"{walls} walls, {points} points"
    )


def _report(options: argparse.Namespace, driver: Driver | None, last: SurveyStep, log: SurveyLog) -> ExitCode:
    """Print how a drive ended; return NOT_REACHED if a waypoint was left out."""
    out = sys.stderr if options.json else sys.stdout
    contacts = f", {len(log.contacts)} contacts" if log.contacts else ""
    print(f"driven for {last.elapsed_s:.0f} s{contacts}: {last.ended or 'ended'}", file=out, flush=True)
    if not isinstance(driver, WaypointDriver):
        return ExitCode.DONE
    for (x, y), reason in driver.skipped:
        print(f"waypoint ({x:g}, {y:g}) left out: {reason}", file=out, flush=True)
    return ExitCode.NOT_REACHED if driver.skipped or driver.remaining else ExitCode.DONE


# Files.


def _write_files(options: argparse.Namespace, found: LearnedMap, model: str, recordings: list[Path]) -> None:
    """Write the world file and the calibration."""
    names = " ".join(path.name for path in recordings)
    comment = f"nomad map learn --from {names}: {found.quality.explained:.0%} of the ranges explained"
    arguments.write_world(options.out, found.world(options.out.stem), comment)
    if options.calibration_out is not None:
        arguments.write_text(options.calibration_out, format_calibration(model, found.calibration, comment))
