"""From submissions to the leaderboard: submissions are written, checked, ranked and shown."""
