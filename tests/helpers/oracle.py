"""The rules of the world, written literally and without regard to speed, to compare the simulator with.

This is independent of the package: only a scenario's parameters and map come from it. The rules are those of the paper (Theile
et al., ICAR 2021), eqs. (5) to (15), and of docs/rules.md. A team is a list of oracles that share targets: `team`.
"""

import math
from statistics import NormalDist

import numpy as np

MOVES = {0: (-1, 0), 1: (0, 1), 2: (1, 0), 3: (0, -1)}
HOVER, LAND = 4, 5
MASK = 2**64 - 1
GOLDEN = 0x9E3779B97F4A7C15


def ray(x0, y0, x1, y1):
    """Return the cells (x, y) of a ray, including source and border cell; x is the column."""
    dx, dy = abs(x0 - x1), -abs(y0 - y1)
    e = dx + dy
    x, y = x0, y0
    cells = [(x, y)]
    while (x, y) != (x1, y1):
        if 2 * e - dy > dx - 2 * e:
            x += 1 if x1 > x0 else -1
            e += dy
        else:
            y += 1 if y1 > y0 else -1
            e += dx
        cells.append((x, y))
    return cells


def visible(building, source):
    """Return the cells that are visible from ``source`` (row, column), as a mask."""
    rows, cols = building.shape
    seen = np.zeros((rows, cols), dtype=bool)
    border = [(y, x) for y in range(rows) for x in range(cols) if y in (0, rows - 1) or x in (0, cols - 1)]
    for y1, x1 in border:
        for x, y in ray(source[1], source[0], x1, y1)[1:]:
            if building[y, x]:
                break
            seen[y, x] = True
    seen[source] = True
    return seen


def mix(z):
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def stream(key, purpose):
    return mix((mix((key + GOLDEN) & MASK) + purpose * GOLDEN) & MASK)


def noise(key, step, communication_step, device, uav=0):
    """Return a standard normal number that depends on the arguments only."""
    start = stream(stream(key, 3), step)
    bits = mix((start + ((uav << 32) + (communication_step << 16) + device) * GOLDEN) & MASK)
    return NormalDist().inv_cdf(((bits >> 11) + 0.5) / 2**53)


def team(scenario, starts, budgets, targets, key=0, noisy=True):
    """Return the UAVs of a team in the order in which they move, which is also the order in which to step them."""
    uavs = [Oracle(scenario, start, budget, targets, key, noisy) for start, budget in zip(starts, budgets, strict=True)]
    for number, uav in enumerate(uavs):
        uav.number, uav.team = number, uavs
        if scenario.mission.kind == "coverage":
            uav.D = uavs[0].D
        else:
            uav.devices = uavs[0].devices
    return uavs


class Oracle:
    """One UAV's episode. ``targets`` is a mask (CPP) or a list of [row, column, data] (DH)."""

    def __init__(self, scenario, start, budget, targets, key=0, noisy=True):
        cells = np.array([list(row) for row in scenario.rows])
        self.scenario, self.mission = scenario, scenario.mission
        self.landing, self.building = cells == "L", (cells == "#") | (cells == "b")
        self.no_fly = (cells == "N") | (cells == "#")
        self.rows, self.cols = cells.shape
        self.p, self.b, self.t = tuple(start), int(budget), 0
        self.key, self.noisy = int(key), noisy
        self.landed = self.done = False
        self.blocked = 0
        self.number, self.team = 0, [self]
        if self.mission.kind == "coverage":
            self.D = np.array(targets, dtype=float)
        else:
            self.devices = [((int(r), int(c)), float(data)) for r, c, data in targets]
            self.sight = [visible(self.building, cell) for cell, _ in self.devices]
        self.total = self.left()

    def left(self):
        return self.D.sum() if self.mission.kind == "coverage" else math.fsum(data for _, data in self.devices)

    def target_map(self):
        if self.mission.kind == "coverage":
            return self.D
        D = np.zeros((self.rows, self.cols))
        for cell, data in self.devices:
            D[cell] = data
        return D

    def cr(self):
        return 1 - self.left() / self.total

    def step(self, action):
        """Fly one action; return the reward."""
        rewards = self.scenario.rewards
        old = self.p
        lands = action == LAND and bool(self.landing[self.p])
        if action in MOVES:  # with the safety controller
            y, x = self.p[0] + MOVES[action][0], self.p[1] + MOVES[action][1]
            held = any(other.p == (y, x) and not other.done for other in self.team)
            if not (0 <= y < self.rows and 0 <= x < self.cols) or self.no_fly[y, x] or held:
                self.blocked += 1
            else:
                self.p = (y, x)
        self.b -= 1
        self.t += 1
        self.landed = lands
        self.done = lands or self.b == 0
        reward = 0.0
        if not lands:
            reward += rewards.movement
            if self.p == old and action != HOVER:
                reward += rewards.safety
            if self.b == 0:
                reward += rewards.crash
        if not self.done:
            gain = self.cover() if self.mission.kind == "coverage" else self.collect(old)
            reward += rewards.collect * gain
        return reward

    def cover(self):
        """Cover the targets in the camera's square, without buildings and cells that are not visible; return how many."""
        half, gain = self.mission.camera_size // 2, 0
        seen = visible(self.building, self.p)
        for y in range(self.p[0] - half, self.p[0] + half + 1):
            for x in range(self.p[1] - half, self.p[1] + half + 1):
                inside = 0 <= y < self.rows and 0 <= x < self.cols
                if inside and seen[y, x] and not self.building[y, x] and self.D[y, x]:
                    self.D[y, x] = 0
                    gain += 1
        return gain

    def collect(self, old):
        """Fly the communication steps of one move; return the data collected."""
        m, gain = self.mission, 0.0
        edge = math.sqrt(2) / 2 * max(self.rows, self.cols) * m.cell_size
        gamma = 10 ** (m.edge_snr / 10) * edge**m.path_loss_exponent.los
        for k in range(1, m.communication_steps + 1):
            place = [old[n] + k / m.communication_steps * (self.p[n] - old[n]) for n in (0, 1)]
            rates = []
            for j, (cell, data) in enumerate(self.devices):
                if data <= 0:
                    rates.append(-1.0)
                    continue
                d = math.sqrt(
                    ((cell[0] - place[0]) * m.cell_size) ** 2 + ((cell[1] - place[1]) * m.cell_size) ** 2 + m.altitude**2
                )
                los = self.sight[j][round(place[0]), round(place[1])]
                alpha = m.path_loss_exponent.los if los else m.path_loss_exponent.nlos
                variance = m.fading_variance.los if los else m.fading_variance.nlos
                eta = math.sqrt(variance) * noise(self.key, self.t, k, j, self.number) if self.noisy else 0.0
                rates.append(math.log2(1 + gamma * d**-alpha * 10 ** (eta / 10)))
            best = int(np.argmax(rates))
            if rates[best] < 0:
                continue
            cell, data = self.devices[best]
            served = min(rates[best], data)
            self.devices[best] = (cell, data - served)
            gain += served
        return gain

    def mask(self):
        """Return which actions are valid; a UAV that moves earlier does not block, since its cell may be free by then."""
        mask = [1] * 6
        later = [other.p for other in self.team[self.number + 1 :] if not other.done]
        for action, (down, right) in MOVES.items():
            y, x = self.p[0] + down, self.p[1] + right
            mask[action] = int(0 <= y < self.rows and 0 <= x < self.cols and not self.no_fly[y, x] and (y, x) not in later)
        mask[LAND] = int(self.landing[self.p])
        return mask

    def centred(self):
        """Return the centred map, padded with [0, 1, 1, 0]: eqs. (5) to (7). Teams have two more layers, padded with 0."""
        layers = [self.landing, self.no_fly, self.building, self.target_map()]
        if self.scenario.uavs is not None:
            there, budgets = np.zeros((2, self.rows, self.cols))
            for other in self.team:
                if other is not self and not other.done:
                    there[other.p], budgets[other.p] = 1, other.b
            layers += [there, budgets]
        C = np.zeros((len(layers), 2 * self.rows - 1, 2 * self.cols - 1))
        for k, (layer, pad) in enumerate(zip(layers, (0, 1, 1, 0, 0, 0)[: len(layers)], strict=True)):
            for i in range(2 * self.rows - 1):
                for j in range(2 * self.cols - 1):
                    y, x = i + self.p[0] - (self.rows - 1), j + self.p[1] - (self.cols - 1)
                    C[k, i, j] = layer[y, x] if 0 <= y < self.rows and 0 <= x < self.cols else pad
        return C

    def observation(self, local_size, scale):
        """Return the observation, with local crop and global means: eqs. (8) to (15)."""
        C = self.centred()
        top, left = self.rows - 1 - local_size // 2, self.cols - 1 - local_size // 2
        high, wide = C.shape[1] // scale, C.shape[2] // scale
        Y = np.zeros((len(C), high, wide))
        for i in range(high):
            for j in range(wide):
                block = C[:, i * scale : (i + 1) * scale, j * scale : (j + 1) * scale]
                Y[:, i, j] = block.reshape(len(C), -1).sum(axis=1) / scale**2
        return {
            "local": C[:, top : top + local_size, left : left + local_size],
            "global": Y,
            "budget": np.array([float(self.b)]),
        }
