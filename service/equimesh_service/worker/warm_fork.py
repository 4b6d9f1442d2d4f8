"""To be imported by the process that workers are forked from: it warms up, so that they are warm from the beginning.

A worker that replaces a killed one is then ready at once. All workers share the memory of the loops.
"""

import gc

from equimesh.compiling import silence
from equimesh_service.worker.warmth import warm_up_unless_compiling

silence()  # the service tells how far its workers are
warm_up_unless_compiling()
gc.collect()  # once: workers never look through what is here
