"""The meshes of a Schwarz iteration, to be shown one after the other."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from equimesh import Event, Iteration

# The most coordinates x that the frames have in all, and as many y: 8 MiB together in single precision.
MAX_COORDINATES = 1 << 20
# The fewest frames that are kept, however many points a mesh has.
MIN_FRAMES = 8


@dataclass
class Frames:
    """Keeps the meshes of an iteration while it runs: all of them, or every second, fourth, … of a long one.

    ``numbers`` are those of the iterations. The last mesh is always kept. An iteration that begins again takes the
    place of the one before.
    """

    points: int
    numbers: list[int] = field(default_factory=list)
    _every: int = 1
    _kept: list[npt.NDArray[np.float32]] = field(default_factory=list)
    _last: Iteration | None = None

    def __call__(self, event: Event) -> None:
        """Keep the mesh of an iteration; other events of the solver have none."""
        if not isinstance(event, Iteration):
            return
        if event.iteration == 0:  # another iteration, such as one with a weaker monitor, takes the place of the first
            self.numbers, self._kept, self._every = [], [], 1
        self._last = event
        if event.iteration % self._every:
            return
        self._add(event)
        if len(self.numbers) > self._most:
            self._every *= 2
            kept = [at for at, number in enumerate(self.numbers) if number % self._every == 0]
            self.numbers = [self.numbers[at] for at in kept]
            self._kept = [self._kept[at] for at in kept]

    def arrays(self) -> dict[str, npt.NDArray[np.float32]]:
        """``frames_x`` and ``frames_y`` of shape ``(frames, n_xi, n_eta)``; nothing without an iteration."""
        if self._last is None:
            return {}
        if self.numbers[-1] != self._last.iteration:
            self._add(self._last)
        frames = np.stack(self._kept)
        return {"frames_x": frames[:, 0], "frames_y": frames[:, 1]}

    @property
    def _most(self) -> int:
        return max(MIN_FRAMES, MAX_COORDINATES // self.points)

    def _add(self, event: Iteration) -> None:
        self.numbers.append(event.iteration)
        self._kept.append(np.stack([event.mesh.x, event.mesh.y]).astype(np.float32))
