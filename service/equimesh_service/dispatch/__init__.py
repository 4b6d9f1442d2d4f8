"""Who waits for what: the queue's dispatcher, side workers, wake-ups."""
