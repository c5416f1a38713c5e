"""The world: scenarios, cities, episodes, keyed random numbers, and the files that ship with the package."""
