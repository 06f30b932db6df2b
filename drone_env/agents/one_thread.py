"""Products of matrices in the calling thread alone.

Those of our networks are small. NumPy's library deals each of them out to as many threads as there are processors,
which spin while they wait for each other: beside other work that takes several times as long.
"""

from threadpoolctl import ThreadpoolController

in_one_thread = ThreadpoolController().wrap(limits=1, user_api="blas")
"""A decorator: NumPy computes in one thread while the function runs, and as before after it."""
