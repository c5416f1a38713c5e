"""The paper's tables I and IV: the sizes of the network, computed from the networks themselves.

Usage: python docs/reproduction/tables_1_and_4.py
"""

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.simulation.observation import Observer

CITIES = ("Manhattan32", "Urban50")


def sizes(name, local_size=None, global_scale=None):
    """Return the number of inputs of the first dense layer, and the number of parameters."""
    scenario = load_scenario(name).with_observation(local_size, global_scale)
    network = find_agent("ddqn").module().Network(Observer(scenario))
    return network.inputs, sum(each.numel() for each in network.parameters())


def main():
    """Print both tables."""
    print("Table I: parameters. The paper's counts are those of six input layers, but it describes four.\n")
    print(
        "| map | l | g | flatten layer N | parameters, 4 layers | parameters, 6 layers |\n| --- | --- | --- | --- | --- | --- |"
    )
    for city in CITIES:
        observation = load_scenario(f"{city}-CPP-v0").observation
        inputs, parameters = sizes(f"{city}-CPP-v0")
        kernels = 2 * 2 * 16 * 25  # two more layers in each branch
        print(
            f"| {city} | {observation.local_size} | {observation.global_scale} | {inputs:,} | {parameters:,} | "
            f"{parameters + kernels:,} |"
        )
    print("\nTable IV: the flatten layer's size N on Manhattan32, by local size and global scale.\n")
    locals_, scales = (9, 17, 25, 33), (2, 3, 5, 7)
    print("| | " + " | ".join(f"g = {g}" for g in scales) + " |\n| --- |" + " --- |" * len(scales))
    for local_size in locals_:
        row = [f"{sizes('Manhattan32-CPP-v0', local_size, g)[0]:,}" for g in scales]
        print(f"| l = {local_size} | " + " | ".join(row) + " |")
    print(f"\nWithout the scheme (l = 0, g = 1): {sizes('Manhattan32-CPP-v0', 0, 1)[0]:,}")


if __name__ == "__main__":
    main()
