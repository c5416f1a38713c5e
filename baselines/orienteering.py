"""Orienteering: a routing solver chooses which places to visit, and in which order, within the budget; fly there and land.

Each stop of a tour has a prize, and the moves from stop to stop and to a landing zone must fit the budget. This is the
orienteering problem (Golden, Levy and Vohra, Naval Research Logistics 34, 1987). PyVRP (Wouda, Lan and Kool, INFORMS Journal on
Computing 36, 2024) solves it as a prize-collecting vehicle routing problem with one vehicle. The prizes are only a model,
because much is covered or collected between the stops. So each tour found is simulated cell by cell, and the best is kept.

CPP: the stops are cells that together see all targets, chosen by greedy set cover; the prize of a stop is the number of targets
that it adds to those of the stops before it.
DH: the stops are cells at or near a device, each with the actions of hovering until the device is empty; the prize is the
device's data. A tour makes at most one stop per device. The expected rates leave out fading.

Needs PyVRP: ``pip install 'uavbench[planning]'``. For one UAV.
"""

import importlib.util
import math
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from uavbench.planning.paths import worthiest_way
from uavbench.simulation.missions.coverage import camera_views
from uavbench.simulation.missions.harvesting import channel_of, log_snr_of
from uavbench.world.city import HOVER, LAND, action_between
from uavbench.world.kernel import kernel

_PRIZE = 100  # of a target or data unit, in moves: so large that the solver does not give up prizes to save moves
_ACTION = 1e-3  # cost of an action in targets or data units: of two tours that yield the same, the shorter one is better
# The most that PyVRP charges for a move beyond the budget: about a stop's prize, so that its search may try too long tours.
_PENALTY = 1000.0
_LARGEST = 128 * 128  # cells: the table of moves between stops, and the solver, need minutes for larger maps


class Stop(NamedTuple):
    """A place to visit. Of the stops for the same thing, a tour makes at most one.

    Attributes
    ----------
    cell : int
        The stop's cell, as an index in row-major order.
    thing : int
        What the stop is for: in DH the device, in CPP the cell itself.
    prize : float
        The expected number of targets or data units.
    service : int
        Actions of hovering there.
    """

    cell: int
    thing: int
    prize: float
    service: int


@dataclass
class Flight:
    """A simulated flight along a tour.

    Attributes
    ----------
    path : list of int
        The cell after each action before ``land``; the same cell twice in a row is a hover.
    tour : list of Stop
        The stops that the flight makes.
    value : float
        Targets or data units that the flight yields, minus a small cost of each action.
    """

    path: list[int]
    tour: list[Stop]
    value: float


class Agent:
    """Plans a tour at the first step, and again every few steps; a better tour replaces the rest of the current one.

    Attributes
    ----------
    iterations : int
        PyVRP's iterations in each round: more of them take longer and find better tours. There is no limit in seconds, so
        that the actions are the same on any machine.
    rounds : int
        Rounds of the first plan, each with other stops; every later plan has one round.
    patience : int
        Steps from one plan to the next.
    """

    track = "state"
    iterations = 100
    rounds = 8
    patience = 5

    def __init__(self, scenario):
        if scenario.team:
            raise ValueError(f"orienteering plans for one UAV; {scenario.id} is for teams: choose one without Team in its id")
        if math.prod(scenario.shape) > _LARGEST:
            raise ValueError(
                f"orienteering takes too long on maps of more than 128×128 cells, as {scenario.id} has: choose planner"
            )
        if importlib.util.find_spec("pyvrp") is None:
            raise ImportError("orienteering needs PyVRP: pip install 'uavbench[planning]'")
        self._scenario = scenario
        self._city: Any = None

    def reset(self, info):
        """Forget the last episode."""
        self._random = np.random.default_rng(info["seed"])
        self._tour, self._steps = [], 0

    def _look_at(self, city):
        """Prepare for a city, if it is another one than before."""
        if city is self._city:
            return
        self._city, self._away = city, {}
        self._home = city.distance_to_landing.reshape(-1).copy()
        self._mission = (_Coverage if self._scenario.mission.kind == "coverage" else _Harvesting)(self._scenario, city)

    def act(self, observation, info):
        """Return the first action of the best tour found."""
        state = info["state"]
        self._look_at(state.city)
        here, budget = self._index(state.position), state.budget - 1  # one action is for landing
        left = self._mission.left(state)
        flight = self._fly(here, self._tour, left, budget)
        if self._steps % self.patience == 0 and left.any():
            rounds = range(self.rounds) if self._steps == 0 else [1]  # a round that keeps the current stops
            flight = self._plan(here, flight, left, budget, rounds)
        self._tour = flight.tour
        self._steps += 1
        if not flight.path:
            return LAND
        return HOVER if flight.path[0] == here else self._move(here, flight.path[0])

    def _plan(self, here, best, left, budget, rounds):
        """Return the best flight of the rounds, or ``best`` if none is better."""
        away = self._distances(here)
        fits = (away >= 0) & (self._home >= 0) & (np.maximum(away, 1) + self._home <= budget)
        for n in rounds:
            stops = self._mission.stops(fits, left, best, n, self._random)
            if stops:
                flight = self._thin(here, self._solve(here, stops, best.tour, budget), left, budget)
                best = max(best, flight, key=lambda flight: flight.value)
        return best

    def _solve(self, here, stops, tour, budget):
        """Return the tour that PyVRP finds; its search begins with those stops of ``tour`` that are among ``stops``."""
        import pyvrp
        from pyvrp.exceptions import PenaltyBoundWarning
        from pyvrp.stop import MaxIterations

        cells = np.array([stop.cell for stop in stops])
        # Location 0 is the start, and 1 the end, which is any landing cell. Distances from a stop include the hovering there.
        distance: Any = np.zeros((len(stops) + 2, len(stops) + 2), dtype=np.int64)
        distance[0, 2:] = np.maximum(self._distances(here)[cells], 1)  # a stop here costs a hover
        for n, stop in enumerate(stops, start=2):
            distance[n] = np.concatenate(([0, self._home[stop.cell]], self._distances(stop.cell)[cells])) + stop.service
            distance[n, n] = 0

        things = {}
        for n, stop in enumerate(stops):
            things.setdefault(stop.thing, []).append(n)
        groups = [numbers for numbers in things.values() if len(numbers) > 1]
        group_of = {n: group for group, numbers in enumerate(groups) for n in numbers}

        data = pyvrp.ProblemData(
            locations=[pyvrp.Location(0, 0)] * len(distance),
            clients=[
                pyvrp.Client(n + 2, prize=1 + round(_PRIZE * stop.prize), required=False, group=group_of.get(n))
                for n, stop in enumerate(stops)
            ],
            depots=[pyvrp.Depot(0), pyvrp.Depot(1)],
            vehicle_types=[pyvrp.VehicleType(start_depot=0, end_depot=1, max_distance=budget)],
            distance_matrices=[distance],
            duration_matrices=[0 * distance],
            groups=[pyvrp.ClientGroup(numbers, required=False) for numbers in groups],
        )
        number = {stop[:2]: n for n, stop in enumerate(stops)}
        begun = [number[stop[:2]] for stop in tour if stop[:2] in number]
        with warnings.catch_warnings(action="ignore", category=PenaltyBoundWarning):  # _PENALTY is low on purpose
            best = pyvrp.solve(
                data,
                MaxIterations(self.iterations),
                seed=int(self._random.integers(2**31)),
                collect_stats=False,
                params=pyvrp.SolveParams(penalty=pyvrp.PenaltyParams(max_penalty=_PENALTY)),
                initial_solution=pyvrp.Solution(data, [begun]) if begun else None,
            ).best
        return [stops[visit.idx] for route in best.routes() for visit in route if visit.is_client()]

    def _thin(self, here, tour, left, budget):
        """Simulate a tour, leaving out each stop without which the flight is worth more."""
        best = self._fly(here, tour, left, budget)
        n = 0
        while n < len(best.tour):
            without = self._fly(here, best.tour[:n] + best.tour[n + 1 :], left, budget)
            if without.value > best.value:
                best = without
            else:
                n += 1
        return best

    def _fly(self, here, tour, left, budget):
        """Simulate a tour, without stops that have nothing left to yield or do not leave enough budget to land."""
        mission, at, path, made, total = self._mission, here, [], [], left.sum()
        left = left.copy()
        worth = mission.worth(left, tour)

        def follow(cells):
            mission.collect(at, cells, left)
            path.extend(cells.tolist())

        for stop in tour:
            distance = self._distances(at)[stop.cell]
            if distance < 0 or len(path) + distance + self._home[stop.cell] > budget or mission.done(stop, left):
                continue
            made.append(stop)
            follow(worthiest_way(at, self._distances(stop.cell), self._city.shape[1], worth))
            at = stop.cell
            while not mission.done(stop, left) and len(path) + 1 + self._home[at] <= budget:
                follow(np.array([at]))
        homeward = worthiest_way(at, self._home, self._city.shape[1], worth)
        follow(mission.linger(at, homeward, left, budget - len(path) - len(homeward)))
        return Flight(path, made, float(total - left.sum()) - _ACTION * len(path))

    def _distances(self, cell):
        """Return the number of moves from a cell to every cell; −1 where there is no path."""
        if cell not in self._away:
            self._away[cell] = self._city.distances(divmod(cell, self._city.shape[1])).reshape(-1)
        return self._away[cell]

    def _index(self, cell):
        """Return the row-major index of a cell."""
        return cell[0] * self._city.shape[1] + cell[1]

    def _move(self, cell, neighbour):
        """Return the move from ``cell`` to ``neighbour``."""
        return action_between(*(divmod(index, self._city.shape[1]) for index in (cell, neighbour)))


class _Coverage:
    """CPP: ``left`` says of each cell whether it is a target, as bool, shape (MN + 1,).

    The last entry is always False: it stands for the cells around the UAV that the camera does not see.
    """

    noise = 0.15  # gains are increased by random shares of up to this, so that the rounds differ

    def __init__(self, scenario, city):
        side, views = scenario.mission.camera_size, camera_views(scenario, city).reshape(-1, 1)
        place = np.arange(side * side)
        down, right = place // side - side // 2, place % side - side // 2
        visible = (views >> place.astype(np.uint64) & np.uint64(1)).astype(bool)
        cells = np.arange(len(views))[:, None] + down * city.shape[1] + right
        self._seen = np.where(visible, cells, len(views))  # the cells that the camera sees from each cell

    def left(self, state):
        """Return the targets left."""
        return np.append(state.target.reshape(-1) > 0, False)

    def done(self, stop, left):
        """Return whether a stop has nothing left to yield."""
        return not left[self._seen[stop.cell]].any()

    def collect(self, at, cells, left):
        """Remove from ``left`` what flying over ``cells`` yields."""
        left[self._seen[cells]] = False

    def worth(self, left, tour):
        """Return what passing each cell between stops is worth: the targets seen from it that no stop sees."""
        rest = left.copy()
        rest[self._seen[[stop.cell for stop in tour]]] = False
        return rest[self._seen].sum(axis=1).astype(float)

    def linger(self, at, homeward, left, spare):
        """Return the way to the landing zone unchanged: the camera gains nothing by hovering."""
        return homeward

    def stops(self, fits, left, best, n, random):
        """Return a greedy set cover.

        In every third round it is a new one. In the others, it keeps the stops of the best flight, and adds stops for the
        targets that this flight leaves.
        """
        left, fits, stops = left.copy(), fits.copy(), []

        def add(cell, prize):
            stops.append(Stop(cell, cell, prize, 0))
            left[self._seen[cell]] = False
            fits[cell] = False

        if n % 3:
            for stop in best.tour:
                add(stop.cell, int(left[self._seen[stop.cell]].sum()))
            left[self._seen[best.path]] = False
        while True:
            gain = np.where(fits, left[self._seen].sum(axis=1), 0)
            if not gain.any():
                return stops
            cell = int(np.argmax(gain * (1.0 + self.noise * random.random(len(gain)) * (n > 0))))
            add(cell, int(gain[cell]))


class _Harvesting:
    """DH: ``left`` holds the data left at each device, shape (K,)."""

    reach = 2  # the largest distance of a stop from its device, in rows plus columns
    patience = 6  # the most actions of hovering at a stop, unless a device would then have no stop

    def __init__(self, scenario, city):
        self._channel, self._city = channel_of(scenario.mission, city.shape), city
        self._rows, self._cols = (index.reshape(-1) for index in np.indices(city.shape))
        self._cells = np.zeros(0, dtype=np.int64)

    def left(self, state):
        """Return the data left."""
        cells = state.device_cell @ np.array([self._city.shape[1], 1])
        if not np.array_equal(cells, self._cells):  # a new episode
            self._cells = cells
            self._sight = np.array([self._city.visible(cell).reshape(-1) for cell in state.device_cell])
            self._rates = np.array([self._rate(k) for k in range(len(cells))])
        return state.device_data.copy()

    def _rate(self, k):
        """Return the data units of device ``k`` per action of hovering in each cell, without fading."""
        r, c = divmod(int(self._cells[k]), self._city.shape[1])
        square = ((self._rows - r) ** 2 + (self._cols - c) ** 2) * self._channel.cell_size**2 + self._channel.altitude**2
        blocked, clear = self._channel.half_exponent
        level = self._channel.log_gain - np.where(self._sight[k], clear, blocked) * np.log(square)
        return np.maximum(self._channel.steps * np.log2(1.0 + np.exp(level)), 1e-9)

    def done(self, stop, left):
        """Return whether a stop has nothing left to yield."""
        return left[stop.thing] <= 0.0

    def collect(self, at, cells, left):
        """Remove from ``left`` what flying over ``cells`` yields."""
        _serve(at, cells, left, self._city.shape[1], self._cells, self._sight, self._channel)

    def worth(self, left, tour):
        """Return what passing each cell between stops is worth: the highest rate of a device with data left."""
        return np.where(left[:, None] > 0.0, self._rates, 0.0).max(axis=0)

    def linger(self, at, homeward, left, spare):
        """Return the way to the landing zone with ``spare`` actions of hovering where the rate is highest."""
        cells = np.concatenate(([at], homeward))
        rates = self.worth(left, [])[cells]
        n = int(np.argmax(rates))
        if spare <= 0 or rates[n] <= _ACTION:
            return homeward
        return np.concatenate((cells[1 : n + 1], np.full(spare, cells[n]), cells[n + 1 :]))

    def stops(self, fits, left, best, n, random):
        """Return the stops for each device with data left: cells near the device, or else the nearest one that fits.

        The moves to a stop and away from it collect data too: if they are straight, about as much as 2 to 4 actions of
        hovering. Each round shortens the hovering by a random number in this range, so that the rounds differ.
        """
        passing, stops = random.uniform(2.0, 4.0), []
        for k in np.flatnonzero(left > 0.0).tolist():
            r, c = divmod(int(self._cells[k]), self._city.shape[1])
            down, right = np.abs(self._rows - r), np.abs(self._cols - c)
            hover = np.ceil(np.maximum(left[k] / self._rates[k] - passing, 0.0))
            near = fits & (down + right <= self.reach) & (hover <= self.patience)
            if not near.any():
                near = np.arange(len(fits)) == np.argmin(np.where(fits, np.hypot(down, right), np.inf))
            stops += [Stop(int(cell), k, float(left[k]), int(hover[cell])) for cell in np.flatnonzero(near & fits)]
        return stops


@kernel
def _serve(at, path, left, cols, cells, sight, channel):
    """Remove from ``left`` what is collected on a path from ``at`` if the device with the highest expected rate is served."""
    for cell in path:
        r0, c0, r1, c1 = at // cols, at % cols, cell // cols, cell % cols
        for n in range(1, channel.steps + 1):
            r, c = r0 + n / channel.steps * (r1 - r0), c0 + n / channel.steps * (c1 - c0)
            here = int(np.rint(r)) * cols + int(np.rint(c))
            best, highest = -1, -np.inf
            for k in range(len(left)):
                if left[k] > 0.0:
                    level = log_snr_of(channel, cells[k] // cols, cells[k] % cols, r, c, int(sight[k, here]))
                    if level > highest:
                        best, highest = k, level
            if best < 0:
                return
            left[best] = max(0.0, left[best] - math.log2(1.0 + math.exp(highest)))
        at = cell
