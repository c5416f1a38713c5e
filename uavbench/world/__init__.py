"""What is fixed and what is drawn: scenarios, cities, episodes, keyed random numbers, and the files that are shipped."""
