"""Compare `robot.refresh()` over TCP with pymodbus reading as many words: client and server in one process each.

    python benchmarks/modbus.py [--rounds N] [--calls N] [--json]

Target: 2.5 times the round trips of pymodbus. Both servers run in an event loop of their own thread, both clients are
the blocking ones; the sides take turns. Needs `pip install -e '.[bench]'`.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import logging
import queue
import threading
import warnings
from typing import Final

from echo import compare, parsed_options
from pymodbus.client import ModbusTcpClient
from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext
from pymodbus.server import ModbusTcpServer

from nclient import connect
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.inprocess import open_address

TARGET_RATIO: Final = 2.5
# Words of a state reply without a laser and stamps.
WORDS: Final = 49
MODBUS_PORT: Final = 15021


async def _serve(ports: queue.SimpleQueue[int]) -> None:
    emulator = open_address("sim:thesis_room").emulator
    # No lockstep: time runs by the clock, as with a daemon.
    emulator.clock.lockstep_s = None
    daemon = Daemon(emulator)
    # No limit of the request rate: the client sends as fast as it can.
    daemon.admission.limits = dataclasses.replace(daemon.admission.limits, rate=0)
    port = await daemon.listen("127.0.0.1", 0)
    registers = ModbusDeviceContext(hr=ModbusSequentialDataBlock(1, [7] * (WORDS + 1)))
    peer = ModbusTcpServer(ModbusServerContext(devices=registers, single=True), address=("127.0.0.1", MODBUS_PORT))
    await peer.serve_forever(background=True)
    ports.put(port)
    await daemon.serve(asyncio.Event())


def measure(rounds: int, calls: int) -> dict[str, float]:
    """Return the rates and their ratio."""
    ports: queue.SimpleQueue[int] = queue.SimpleQueue()
    threading.Thread(target=lambda: asyncio.run(_serve(ports)), daemon=True).start()
    port = ports.get(timeout=10.0)
    peer = ModbusTcpClient("127.0.0.1", port=MODBUS_PORT)
    peer.connect()

    def read() -> None:
        # An answer with an error code would be faster, and must not be counted.
        assert not peer.read_holding_registers(1, count=WORDS).isError()

    with connect(f"nserver://127.0.0.1:{port}/1") as robot:
        paces = compare({"refresh": lambda: robot.refresh() and None, "modbus": read}, rounds, calls)
    return {
        "refresh_per_second": paces["refresh"].per_second,
        "modbus_per_second": paces["modbus"].per_second,
        "ratio": paces["refresh"].per_second / paces["modbus"].per_second,
        "ratio_target": TARGET_RATIO,
    }


def main() -> None:
    """Measure and print."""
    options = parsed_options(__doc__)
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    result = measure(options.rounds, options.calls)
    if options.json:
        print(json.dumps(result))
        return
    print(f"refresh {result['refresh_per_second']:.0f}/s, pymodbus {result['modbus_per_second']:.0f}/s: "
          f"ratio {result['ratio']:.2f} (target {TARGET_RATIO})")


if __name__ == "__main__":
    main()
