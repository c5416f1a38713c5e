"""What a picture of an episode shows, and how it becomes pixels or a window."""
