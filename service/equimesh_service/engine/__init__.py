"""Where tasks run: a narrow port, and a pool of processes behind it."""
