"""Agent × scenario × split → result: flights, results on disk, replays, comparisons, metrics, reference tables."""
