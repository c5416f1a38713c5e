"""Submissions → leaderboard: what is handed in, checked, ranked, and shown."""
