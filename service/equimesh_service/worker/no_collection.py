"""To be imported first by the process that workers are forked from: what it imports stays, so none of it is looked for.

That takes a tenth of the time of the imports. The module ``warm_fork``, which is imported last, ends it.
"""

import gc

gc.disable()
