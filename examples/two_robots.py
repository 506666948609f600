"""Two robots at the same time, with asyncio: each drives until it is near something.

    nserver hall --robots 2 --port 7019 --speed 10
    python examples/two_robots.py [nserver://HOST:PORT]

Without an address each has a simulation of its own.
"""

import asyncio
import sys

from nclient import connect_async


async def approach(address: str) -> str:
    async with connect_async(address) as robot:
        await robot.drive(translation_in_s=8)
        while min((await robot.refresh()).sonars_in[0:2]) > 24:
            await robot.sleep(0.05)  # meanwhile the other robot goes on
        state = await robot.stop()
        return f"{address}: {state.sonars_in[0]} in before the wall after {state.x_in:.0f} in"


async def main() -> None:
    server = sys.argv[1] if len(sys.argv) > 1 else ""
    addresses = [f"{server}/1", f"{server}/2"] if server else ["sim:thesis_room", "sim:hall"]
    for line in await asyncio.gather(*map(approach, addresses)):
        print(line)


asyncio.run(main())
