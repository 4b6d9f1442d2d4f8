"""The waiting for workers and for meshes: the queue's dispatcher, side workers, wake-ups."""
