"""To be imported first by the process that workers are forked from: what it imports stays, so none of it is looked for.

That takes a quarter of the time of the imports. It only forks afterwards; each worker searches among what it makes.
"""

import gc

gc.disable()
