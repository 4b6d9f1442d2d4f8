"""What `equimesh bench` measures: numbers, never claims. Needs the solver; nothing here is imported without it."""
