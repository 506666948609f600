"""Serve a robot as ROS 2 topics by DDS, without ROS on this machine.

    nomad ros2 "serial:///dev/ttyUSB0?model=n150"        for programs on this machine (ROS_LOCALHOST_ONLY=1)
    nomad ros2 nserver://lab/1 --interface eth0          for those on the network of eth0: there is no password
    nomad ros2 sim:thesis_room --map thesis_room         /map is that world
    nomad ros2 --print-config                            CYCLONEDDS_URI for other programs on loopback

Topics /robot1/odom, /robot1/sonar, /tf and others, /robot1/cmd_vel in, in the domain of ROS_DOMAIN_ID; nserver --ros2
serves simulated robots the same way. The robot stops when the program that drives it ends or falls silent, or this
command ends.
"""

import argparse

from nclient.common.arguments import add_address, add_flag
from nclient.connector import address_or_default
from nserver_emu import cli
from nserver_emu.ros.options import ANY, DEFAULT_PORT, LOOPBACK, add_distro, config_of, port_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser)
    parser.add_argument("--interface", default=LOOPBACK, metavar="NAME",
                        help=f"network interface or its address, such as eth0; {ANY}: that of CYCLONEDDS_URI, or what "
                        f"Cyclone DDS chooses (default: {LOOPBACK})")
    parser.add_argument("--map", metavar="WORLD", help="publish this world as /map: a shipped world or a TOML file")
    add_distro(parser, "--distro")
    parser.add_argument("--rosbridge", nargs="?", type=port_text, const=str(DEFAULT_PORT), metavar="[HOST:]PORT",
                        help="serve rosbridge as well; to the printed address `nomad localize --publish` sends "
                        f"estimates for both (default: port {DEFAULT_PORT}; needs the extra viewer)")
    add_flag(parser, "--print-config",
             "print a configuration of Cyclone DDS, with which its other programs find this one, and exit")


def run(options: argparse.Namespace) -> int:
    """Serve until the end, and return the exit code."""
    if options.print_config:
        print(config_of(options.interface) or "")
        return 0
    words = [options.map] if options.map else []
    words += ["--real", address_or_default(options.address), "--port", "0", "--ros2", options.interface]
    words += ["--ros2-distro", options.distro]
    words += ["--rosbridge", options.rosbridge] if options.rosbridge else []
    return cli.main(words)
