"""TSP: fly the best tour over the devices, hover at each until it is empty, fly to a landing zone and land. DH only.

The tour visits the subset of the devices, in the order, that collects most within the budget. The budget must suffice for the
moves from place to place and to a landing zone, and for hovering at each place until its device is empty at the expected rate.
If a device's cell cannot be reached in time, its place is the nearest cell that can. Dynamic programming finds the best of all
subsets and orders (Held and Karp, A dynamic programming approach to sequencing problems, Journal of SIAM 10(1), 1962).
"""

import math

import numpy as np

from uavbench.simulation.missions.harvesting import channel_of
from uavbench.world.city import HOVER, LAND
from uavbench.world.kernel import kernel

MAX_DEVICES = 10  # each device more doubles time and memory; if there are more, those with most data are considered


class Agent:
    """Flies to the first device of its tour, and plans again only when a device has been emptied, this one or another."""

    track = "state"

    def __init__(self, scenario):
        if scenario.mission.kind != "harvesting" or scenario.team:
            raise ValueError(
                f"tsp is for data harvesting by one UAV (Manhattan32-DH-v0 and its like), not for {scenario.id}: "
                "for coverage by one UAV there is boustrophedon, for teams planner"
            )
        self._channel = channel_of(scenario.mission, scenario.shape)
        self._left, self._goal = None, None

    def reset(self, info):
        """Forget the tour: the devices that it is for, and its first place."""
        self._left, self._goal = None, None

    def act(self, observation, info):
        """Return the next action: a move to the goal, hovering there, a move to a landing zone, or landing."""
        state = info["state"]
        city, here = state.city, state.position
        left = np.flatnonzero(state.device_data).tolist()
        if left != self._left:
            self._left, self._goal = left, self._plan(state, left)
        if self._goal is not None:
            away = city.distances(self._goal)
            needed = max(away[here], 1) + city.distance_to_landing[self._goal] + 1  # at the goal, 1 to hover; + 1 to land
            if needed <= state.budget:
                return city.step_towards(away, here) if away[here] else HOVER
        home = city.distance_to_landing
        return city.step_towards(home, here) if home[here] else LAND

    def _plan(self, state, left):
        """Return the first place to hover of the best tour over the devices ``left``; None if no tour is worth its moves."""
        if not left:
            return None
        city, away = state.city, state.city.distances(state.position)
        in_time = (away >= 0) & (away + city.distance_to_landing + 1 <= state.budget)  # + 1 to land
        left = sorted(left, key=lambda k: -state.device_data[k])[:MAX_DEVICES]
        cells = state.device_cell[left]
        places = [_place(in_time, *cell) for cell in cells.tolist()]
        rows, cols = np.array(places).T
        between = np.array([city.distances(place)[rows, cols] for place in places])
        rates = np.array([self._rate(city, cell, place) for cell, place in zip(cells, places, strict=True)])
        home = city.distance_to_landing[rows, cols]
        tour = _best_tour(away[rows, cols], between, home, state.device_data[left], rates, state.budget)
        return places[tour[0]] if len(tour) else None

    def _rate(self, city, device, place):
        """Return the mean, over fading, of the data units that an action of hovering at ``place`` collects from the device."""
        channel = self._channel
        ground = channel.cell_size * np.hypot(*(device - place))
        clear = int(city.visible(device)[place])
        level = channel.log_gain - channel.half_exponent[clear] * math.log(ground**2 + channel.altitude**2)
        nodes, weights = np.polynomial.hermite_e.hermegauss(16)  # the mean over a normal variable
        rates = np.logaddexp(0.0, level + channel.fading[clear] * nodes) / math.log(2.0)
        return channel.steps * max(float(rates @ weights / weights.sum()), 1e-9)


@kernel
def _best_tour(first, between, home, data, rates, budget):
    """Return the subset of the K devices, in the order to visit them, that collects most within the budget.

    Parameters
    ----------
    first, home : ndarray of int32, shape (K,)
        Number of moves from the UAV to the place of each device, and from there to the nearest landing cell.
    between : ndarray of int32, shape (K, K)
        Number of moves from place to place.
    data, rates : ndarray of float64, shape (K,)
        Data left, and data that an action of hovering collects, in data units.
    budget : int
        Actions left.
    """
    number = len(data)
    far = 1 << 30
    moves = np.full((1 << number, number), far, dtype=np.int64)  # the fewest for each subset and last device
    before = np.full((1 << number, number), -1, dtype=np.int64)
    best, best_subset, best_last = 0.0, 0, -1
    for subset in range(1, 1 << number):
        needed = worth = 0.0
        for k in range(number):
            if subset >> k & 1:
                needed += max(0.0, data[k] / rates[k] - 1.0)  # the half moves before and after are worth a hover
                worth += data[k]
        for last in range(number):
            if not subset >> last & 1:
                continue
            rest = subset ^ (1 << last)
            if rest == 0:
                moves[subset, last] = first[last]
            for k in range(number):
                if rest >> k & 1 and moves[rest, k] + between[k, last] < moves[subset, last]:
                    moves[subset, last] = moves[rest, k] + between[k, last]
                    before[subset, last] = k
            hovering = budget - 1 - home[last] - moves[subset, last]  # one action is for landing
            if hovering < 0:
                continue
            value = worth - max(0.0, needed - hovering) * rates[last]  # the last device keeps what there is no time for
            value -= 1e-3 * (moves[subset, last] + home[last])  # of equally good tours, the shortest
            if value > best:
                best, best_subset, best_last = value, subset, last
    order = np.empty(number, dtype=np.int64)
    start = number
    while best_last >= 0:
        start -= 1
        order[start] = best_last
        best_subset, best_last = best_subset ^ (1 << best_last), before[best_subset, best_last]
    return order[start:]


def _place(in_time, r, c):
    """Return where to hover for the device at (r, c): its cell, or the nearest one that the UAV can reach in time."""
    rows, cols = np.indices(in_time.shape)
    distance = np.where(in_time, np.hypot(rows - r, cols - c), np.inf)
    return divmod(int(np.argmin(distance)), distance.shape[1])
