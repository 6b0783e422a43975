"""Prints the replies to scenarios, by wasmtime: python by_wasmtime.py MODULE REQUESTS."""

from __future__ import annotations

import sys
from pathlib import Path

from wasmtime import Engine, Func, Instance, Memory, Module, Store


class Swarms:
    """An instance of the module, which holds nothing at first."""

    def __init__(self, module: Module) -> None:
        self.store = Store(module_engine)
        # Without imports.
        self.exports = Instance(self.store, module, []).exports(self.store)

    def call(self, name: str, *arguments: int) -> int:
        """Calls an export."""
        function = self.exports[name]
        assert isinstance(function, Func)
        returned = function(self.store, *arguments)
        return int(returned or 0)

    def request(self, request: str) -> str:
        """Executes a request. Returns the reply."""
        memory = self.exports["memory"]
        assert isinstance(memory, Memory)
        encoded = request.encode()
        at = self.call("input", len(encoded))
        memory.write(self.store, encoded, at)
        self.call("request")
        at = self.call("output")
        return memory.read(self.store, at, at + self.call("output_len")).decode()


module_engine = Engine()


def main(path: str, requests: str) -> None:
    """Prints the replies to the lines of `requests`; an empty line begins another scenario."""
    module = Module.from_file(module_engine, path)
    swarms = Swarms(module)
    for request in Path(requests).read_text().removesuffix("\n").split("\n"):
        if request:
            print(swarms.request(request))
        else:
            print()
            swarms = Swarms(module)


main(*sys.argv[1:])
