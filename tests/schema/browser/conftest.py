"""The kernel of pages in Node, which comes with Playwright: one process for all tests."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from equimesh_schema.browser.scripts import KERNEL, script

# Each line of the input is a program, whose result is a line of the output.
LOOP = """
const { createInterface } = await import("node:readline");
const flat = (_, value) => (ArrayBuffer.isView(value) ? [...value] : value);
for await (const line of createInterface({ input: process.stdin })) {
  const [body, given] = JSON.parse(line);
  let answer;
  try {
    answer = { result: await new Function("kernel", "given", body)(kernel, given) };
  } catch (error) {
    answer = { fault: error.message, offset: error.offset ?? null };
  }
  console.log(JSON.stringify(answer, flat));
}
"""
Run = Callable[..., Any]


@pytest.fixture(scope="session")
def kernel() -> Iterator[Run]:
    """Runs the body of a function of ``kernel`` and ``given``; raises ValueError with the sentence where it throws."""
    driver = pytest.importorskip("playwright._impl._driver")
    node, *_ = driver.compute_driver_executable()
    program = f"{script(KERNEL)}\nconst kernel = $kernel;\n{LOOP}"
    command = [node, "--input-type=module", "-e", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as started:
        into, out = started.stdin, started.stdout
        assert into is not None
        assert out is not None

        def run(body: str, given: object = None) -> Any:
            print(json.dumps([body, given]), file=into, flush=True)
            answer = json.loads(out.readline())
            if "fault" in answer:
                raise ValueError(answer["fault"])
            return answer.get("result")

        yield run
