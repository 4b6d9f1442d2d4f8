"""What is sent to workers."""

from __future__ import annotations

import numpy as np
from distributed import Client, Future

from equimesh_cluster.connection import MAX_INLINE_BYTES, sent


def test_small_values_are_sent_with_their_task_and_large_ones_are_data_of_the_cluster(client: Client) -> None:
    small = {"n": 3}
    assert sent(client, small) is small
    large = np.arange(MAX_INLINE_BYTES // 8 + 1.0)
    found = sent(client, large)
    assert isinstance(found, Future)
    assert client.submit(lambda values: values.sum(), found, pure=False).result() == large.sum()
