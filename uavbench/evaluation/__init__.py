"""Evaluating an agent on a scenario and a split: episodes, results on disk, replays, comparisons, metrics, reference tables."""
