"""Quick planner: `planner` with one short search, for labels, roll-outs and comparisons at equal time.

In DH it improves the rest of the flights for what is really left only every 16 steps; on large maps as often as `planner`.
"""

import planner


class Agent(planner.Agent):
    """Follows the best flights that one short search finds."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.searches, self.changes, self.refined = 1, 50 if self._harvests else 40, 0
        if self._large:
            self.changes, self.tour_changes = 150, 1_000_000
        else:
            self.mending_interval, self.mending_changes = 16, 200
