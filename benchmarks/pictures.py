"""How fast are pictures? Frames per second of ``render_mode="rgb_array"`` on one thread, compared with copying the same bytes.

Usage: python benchmarks/pictures.py [--rounds 20]. Prints Markdown. Rounds of drawing and copying alternate, and
the best of each counts.
"""

import argparse
import time

import numpy as np

from uavbench.envs.env import UAVEnv

NAMES = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
STEPS = 40


def seconds(function, times):
    """Return the wall time of a call in seconds, as the mean of several."""
    started = time.perf_counter()
    for _ in range(times):
        function()
    return (time.perf_counter() - started) / times


def measure(name, rounds):
    """Return the shape of a frame after 40 steps, and the seconds that drawing and copying it take."""
    env = UAVEnv(name, render_mode="rgb_array")
    env.reset(seed=0)
    random = np.random.default_rng(0)
    for _ in range(STEPS):
        mask = env.action_masks()[:4]
        env.step(int(random.choice(np.flatnonzero(mask))))
    picture = env.render()
    copied = np.empty_like(picture)
    drawing, copying = np.inf, np.inf
    for _ in range(rounds):
        drawing = min(drawing, seconds(env.render, 10))
        copying = min(copying, seconds(lambda: np.copyto(copied, picture), 10))
    return picture.shape, drawing, copying


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    rounds = parser.parse_args().rounds
    print("| scenario | pixels | frames/s | ms/frame | copying it, ms | ratio |")
    print("| --- | --- | ---: | ---: | ---: | ---: |")
    for name in NAMES:
        shape, drawing, copying = measure(name, rounds)
        print(
            f"| {name} | {shape[0]}×{shape[1]} | {1 / drawing:.0f} | {1000 * drawing:.2f} | {1000 * copying:.3f} | "
            f"{drawing / copying:.0f} |"
        )


if __name__ == "__main__":
    main()
