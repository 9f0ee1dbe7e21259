"""All tests of agents let PyTorch use one thread."""

from collections.abc import Iterator

import pytest

from tests.support.torch_threads import one_thread


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    with one_thread():
        yield
