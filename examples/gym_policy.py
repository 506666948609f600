"""Try a policy in an environment of Gymnasium, then let the same object drive a robot: simulated, on a server, or real.

    python examples/gym_policy.py [ADDRESS]
"""

import sys

import gymnasium
import numpy as np

from nserver_emu.gym import run_episode


def policy(observation):
    """Turn to the goal and drive there, and away from what is near ahead: metres, radians, seconds."""
    distance, bearing = observation["goal"]
    ranges = observation["ranges"]
    left, right = ranges[[1, 2, 3]].min(), ranges[[13, 14, 15]].min()
    if min(left, right, ranges[0]) < 0.35 and distance > 0.4:
        return np.array([0.05, 0.6 if left > right else -0.6], dtype=np.float32)
    return np.array([0.25 * max(0.0, np.cos(bearing)), 1.5 * bearing], dtype=np.float32)


env = gymnasium.make("Nomad/GoTo-v0", world="thesis_room")
print(f"goal reached in {sum(run_episode(env, policy, seed=seed).is_success for seed in range(20))} of 20 episodes")

address = sys.argv[1] if len(sys.argv) > 1 else "sim:thesis_room?noisy=1&seed=1"
env = gymnasium.make("Nomad/GoTo-v0", address=address, goal_m=(0.8, 0.5))
try:
    done = run_episode(env, policy)
finally:
    env.close()
print(f"{address}: {'reached' if done.is_success else 'not reached'} after {done.steps * 0.2:.1f} s")
