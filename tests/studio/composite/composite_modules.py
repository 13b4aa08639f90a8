"""The page's modules, run by Node as they are: what needs no browser."""

from typing import Any

from tests.three_js import run_in_node

# vite reads TypeScript, as in the build
_PROGRAM = """
import { text } from "node:stream/consumers";
import { runnerImport } from "vite";
const bytesOf = (hex) => Uint8Array.from(Buffer.from(hex, "hex")).buffer;
const revive = (_, value) => (value?.hex === undefined ? value : bytesOf(value.hex));
const [module, calls] = JSON.parse(await text(process.stdin), revive);
const logLevel = "silent", configFile = false;
const path = `./src/${module}.ts`;
const { module: read } = await runnerImport(path, { configFile, logLevel });
const answers = calls.map(([name, ...given]) => {
    if (typeof read[name] !== "function") return { value: read[name] };
    try {
        return { value: read[name](...given) };
    } catch (error) {
        return { error: error.message };
    }
});
process.stdout.write(JSON.stringify(answers));
process.exit(0);
"""


def called(module: str, *calls: tuple[Any, ...], folder: str = "face/composite/") -> list[Any]:
    """What each (function, arguments...) of a module returns; an Error is its message.

    A function that returns nothing returns None; bytes are given as an ArrayBuffer.
    """
    given = [
        [{"hex": part.hex()} if isinstance(part, bytes) else part for part in call]
        for call in calls
    ]
    answers = run_in_node(_PROGRAM, [folder + module, given])
    return [Error(one["error"]) if "error" in one else one.get("value") for one in answers]


class Error(str):
    """The line that a function threw."""
