"""Make a library for the CPU of a kernel in PTX: ``python translate.py FILE.ptx FILE.so``.

This is no emulator of GPUs. It knows the instructions that Dr.Jit's code generator emits for
kernels without calls, atomics and textures, and runs one thread after the other; what it does not
know is an error. Registers become integers of their size, labels and branches stay what they are.
Needs gcc. ``CUDA_STANDIN_ROUGH`` in the environment: see ``device.h``.
"""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

__all__ = ["library", "translate"]

#: Bits of the registers by their names.
BITS = {"rd": 64, "d": 64, "r": 32, "f": 32, "w": 16, "h": 16, "b": 8, "p": 8}
SPECIAL = {"%ctaid.x": "block", "%ntid.x": "threads", "%tid.x": "thread"}
COMPARE = {
    **{"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="},
    **{"lo": "<", "ls": "<=", "hi": ">", "hs": ">="},
}
ROUND = {"rmi": "floor", "rpi": "ceil", "rzi": "trunc", "rni": "rint"}


class Operands:
    """The operands of one instruction, as expressions in C."""

    def __init__(self, names: list[str], kind: str, registers: dict[str, int]) -> None:
        self.names, self.kind, self.registers = names, kind, registers

    def bits(self, i: int, kind: str = "") -> str:
        """Return an operand as an unsigned integer."""
        return self.expression(self.names[i], kind or self.kind)

    def number(self, i: int, kind: str = "") -> str:
        """Return an operand as a number of the instruction's type, or of another."""
        kind = kind or self.kind
        x = self.bits(i, kind)
        if kind == "pred":
            return x
        return f"as_{kind}({x})" if kind[0] == "f" else f"(({c_type(kind)}) {x})"

    def expression(self, name: str, kind: str) -> str:
        if name.startswith("!"):
            return f"(!{self.expression(name[1:], kind)})"
        if name in SPECIAL:
            return SPECIAL[name]
        if match := re.match(r"%([a-z]+)\d+\w*$", name):
            register = name.replace("%", "_")
            self.registers[register] = BITS[match[1]]
            return register
        if name == "params":
            return "(uint64_t) (uintptr_t) params"
        wide = "ull" if kind.endswith("64") else "u"
        if re.fullmatch(r"0[fd][0-9a-fA-F]+", name):  # the bits of a float
            return f"0x{name[2:]}{wide}"
        if re.fullmatch(r"\d+|0x[0-9a-fA-F]+", name):
            return name + wide
        if re.fullmatch(r"-\d+", name):
            return f"({name})"
        if re.fullmatch(r"-?\d+\.\d*", name):
            code = "<d" if kind == "f64" else "<f"
            return f"0x{struct.pack(code, float(name))[::-1].hex()}{wide}"
        raise NotImplementedError(f"operand {name}")

    def address(self, i: int) -> str:
        base, _, offset = self.names[i].strip("[]").partition("+")
        return f"({self.expression(base, 'u64')} + {offset or 0})"

    def group(self, i: int) -> list[str]:
        """Return the registers of ``{a, b, ...}``, or the one there is."""
        return [x.strip() for x in self.names[i].strip("{} ").split(",")]


def c_type(kind: str) -> str:
    return f"{'int' if kind[0] == 's' else 'uint'}{kind[1:]}_t"


# Each rule takes the operands and the parts of the opcode, and returns the result as a number of
# the instruction's type, or of the type that is given with it.
Rule = Callable[[Operands, list[str]], "str | tuple[str, str]"]


def _binary(sign: str) -> Rule:
    return lambda x, parts: f"{x.number(1)} {sign} {x.number(2)}"


def _bitwise(sign: str) -> Rule:
    return lambda x, parts: (f"{x.bits(1)} {sign} {x.bits(2)}", "bits")


def _multiply(x: Operands, parts: list[str]) -> str | tuple[str, str]:
    if x.kind[0] == "f" or parts[1] == "lo":
        return f"{x.number(1)} * {x.number(2)}"
    bits, signed = int(x.kind[1:]), x.kind[0] == "s"
    wide = f"{'' if signed else 'u'}int{2 * bits}_t"
    if bits == 64:
        wide = f"{'' if signed else 'unsigned '}__int128"
    product = f"(({wide}) {x.number(1)} * ({wide}) {x.number(2)})"
    return (product if parts[1] == "wide" else f"({product} >> {bits})"), "bits"


def _multiply_add(x: Operands, parts: list[str]) -> str | tuple[str, str]:
    if parts[1] == "wide":
        wide = c_type(x.kind[0] + str(2 * int(x.kind[1:])))
        return f"({wide}) {x.number(1)} * ({wide}) {x.number(2)} + {x.bits(3)}", "bits"
    return f"{x.number(1)} * {x.number(2)} + {x.number(3)}"


def _compare(x: Operands, parts: list[str]) -> tuple[str, str]:
    a, b = x.number(1), x.number(2)
    if parts[1] == "nan":
        test = f"({a} != {a} || {b} != {b})"
    elif parts[1] == "ne" and x.kind[0] == "f":  # ordered: other than in C false for NaN
        test = f"({a} < {b} || {a} > {b})"
    else:
        test = f"({a} {COMPARE[parts[1]]} {b})"
    if parts[2] == "and":
        test = f"({test} && {x.bits(3)})"
    elif parts[2] != x.kind and parts[2] != "ftz":
        raise NotImplementedError(".".join(parts))
    return test, "bits"


def _shift(x: Operands, parts: list[str]) -> tuple[str, str]:
    bits, n = int(x.kind[1:]), x.bits(2, "u32")
    name = "LEFT" if parts[0] == "shl" else "SIGNED" if x.kind[0] == "s" else "RIGHT"
    kind = x.kind.replace("b", "u")
    return f"SHIFT_{name}({x.number(1, kind)}, {n}, {bits})", "bits"


def _extreme(x: Operands, parts: list[str]) -> str:
    a, b = x.number(1), x.number(2)
    if x.kind[0] == "f":
        return f"{parts[0]}_{x.kind}_{'nan' if 'NaN' in parts else 'num'}({a}, {b})"
    return f"({a} {'<' if parts[0] == 'min' else '>'} {b} ? {a} : {b})"


def _absolute(x: Operands, parts: list[str]) -> str:
    a = x.number(1)
    return f"fabs({a})" if x.kind[0] == "f" else f"({a} < 0 ? -{a} : {a})"


def _divide(x: Operands, parts: list[str]) -> str:
    if "approx" in parts:
        return f"divide_approx_{x.kind}({x.number(1)}, {x.number(2)})"
    return f"{x.number(1)} / {x.number(2)}"


def _reciprocal(x: Operands, parts: list[str]) -> str:
    a = x.number(1)
    if "approx" not in parts:
        return f"1 / {a}"
    return f"reciprocal_approx_f64({a})" if x.kind == "f64" else f"near_to(1.0 / {a}, 1)"


def _root(x: Operands, parts: list[str]) -> str:
    a = x.number(1)
    return f"near_to(sqrt({a}), 1)" if "approx" in parts else f"sqrt({a})"


def _approximate(function: str) -> Rule:
    def rule(x: Operands, parts: list[str]) -> str:
        if x.kind != "f32":
            raise NotImplementedError(".".join(parts))
        return f"near_to({function.format(x.number(1))}, 2)"

    return rule


def _convert(x: Operands, parts: list[str]) -> str | tuple[str, str]:
    to, of = parts[-2:]
    a = x.number(1, of)
    if of[0] == "f" and to[0] == "f":
        rounding = [ROUND[p] for p in parts[1:-2] if p in ROUND]
        return (f"{rounding[0]}({a})" if rounding else a), to
    if of[0] == "f":
        (rounding,) = (ROUND[p] for p in parts[1:-2] if p in ROUND)
        cast = f"to_{to}" if to in ("u32", "s32") else f"({c_type(to)}) "
        return f"{cast}({rounding}({a}))", "bits"
    return (a, to) if to[0] == "f" else (f"({c_type(to)}) {a}", "bits")


RULES: dict[str, Rule] = {
    "mov": lambda x, parts: (x.bits(1), "bits"),
    "add": _binary("+"),
    "sub": _binary("-"),
    "rem": _binary("%"),
    "and": _bitwise("&"),
    "or": _bitwise("|"),
    "xor": _bitwise("^"),
    "not": lambda x, parts: (f"{'!' if x.kind == 'pred' else '~'}{x.bits(1)}", "bits"),
    "neg": lambda x, parts: f"-{x.number(1)}",
    "abs": _absolute,
    "mul": _multiply,
    "mad": _multiply_add,
    "fma": lambda x, parts: (
        f"__builtin_fma{'f' if x.kind == 'f32' else ''}"
        f"({x.number(1)}, {x.number(2)}, {x.number(3)})"
    ),
    "min": _extreme,
    "max": _extreme,
    "setp": _compare,
    "selp": lambda x, parts: (f"{x.bits(3, 'pred')} ? {x.bits(1)} : {x.bits(2)}", "bits"),
    "shl": _shift,
    "shr": _shift,
    "clz": lambda x, parts: (f"leading_{x.kind[1:]}({x.bits(1)})", "bits"),
    "brev": lambda x, parts: (f"turned_{x.kind[1:]}({x.bits(1)})", "bits"),
    "popc": lambda x, parts: (f"__builtin_popcountll({x.bits(1)})", "bits"),
    "copysign": lambda x, parts: f"copysign({x.number(2)}, {x.number(1)})",
    "div": _divide,
    "rcp": _reciprocal,
    "sqrt": _root,
    "rsqrt": _approximate("1.0 / sqrt((double) {})"),
    "ex2": _approximate("exp2((double) {})"),
    "lg2": _approximate("log2((double) {})"),
    "sin": _approximate("sin((double) {})"),
    "cos": _approximate("cos((double) {})"),
    "tanh": _approximate("tanh((double) {})"),
    "cvt": _convert,
}


def statement(line: str, registers: dict[str, int]) -> str:
    """Return one instruction of PTX in C."""
    guard = ""
    if match := re.match(r"@(!?)(%\w+)\s+", line):
        test = Operands([match[2]], "pred", registers).bits(0)
        guard, line = f"if ({match[1]}{test}) ", line[match.end() :]
    opcode, _, rest = line.partition(" ")
    parts = opcode.split(".")
    if parts[0] == "ret":
        return f"{guard}return;"
    if parts[0] == "bra":
        return f"{guard}goto {rest.strip()};"
    names = [x.strip() for x in re.findall(r"\{[^}]*\}|\[[^\]]*\]|[^,]+", rest) if x.strip()]
    x = Operands(names, parts[-1], registers)
    if parts[0] in ("ld", "ldu", "st"):
        size = int(x.kind[1:])
        which, place = (1, 0) if parts[0] == "st" else (0, 1)
        lines = []
        for i, name in enumerate(x.group(which)):
            value, address = x.expression(name, x.kind), f"{x.address(place)} + {i * size // 8}"
            if parts[0] != "st":
                lines.append(f"{value} = LOAD(uint{size}_t, {address});")
            else:
                lines.append(f"STORE(uint{size}_t, {address}, {value});")
        return f"{guard}{{ {' '.join(lines)} }}"
    if parts[0] not in RULES:
        raise NotImplementedError(opcode)
    result = RULES[parts[0]](x, parts)
    value, kind = result if isinstance(result, tuple) else (result, x.kind)
    if kind[0] == "f":
        value = f"of_{kind}({value})"
    return f"{guard}{x.bits(0)} = {value};"


def translate(text: str) -> str:
    """Return the C source of the one kernel in a PTX text."""
    text = re.sub(r"//[^\n]*", "", text)
    match = re.search(r"\.entry\s+(\w+)\s*\([^)]*\)\s*\{(.*)\n\}", text, re.DOTALL)
    if match is None:
        raise NotImplementedError("a text without a kernel")
    name, body = match.groups()
    registers: dict[str, int] = {}
    lines = []
    for line in re.split(r"[;\n]", body):
        line = line.strip()
        while label := re.match(r"(\w+):\s*", line):
            lines.append(f"{label[1]}:;")
            line = line[label.end() :]
        if line and not line.startswith((".reg", ".pragma")):
            lines.append(statement(line, registers))
    declared = "\n".join(f"uint{bits}_t {x} = 0;" for x, bits in sorted(registers.items()))
    code = "\n".join(lines)
    return f"""#include "device.h"
static void run(const void *params, uint32_t block, uint32_t threads, uint32_t thread) {{
{declared}
{code}
}}
void {name}(const void *params, uint32_t blocks, uint32_t threads) {{
    unsigned before = _mm_getcsr();
    _mm_setcsr(before | 0x8040); /* .ftz: denormals are zero, in float64, too, where none matter */
    for (uint32_t b = 0; b < blocks; b++)
        for (uint32_t t = 0; t < threads; t++) run(params, b, threads, t);
    _mm_setcsr(before);
}}
"""


def library(source: Path, target: Path) -> None:
    """Make a library of a PTX file."""
    code = source.with_suffix(".c")
    code.write_text(translate(source.read_text(encoding="utf-8")), encoding="utf-8")
    command = ["gcc", "-O1", "-w", "-march=native", "-ffp-contract=off", "-shared", "-fPIC"]
    if os.environ.get("CUDA_STANDIN_ROUGH"):
        command.append("-DROUGH")
    here = Path(__file__).resolve().parent
    subprocess.run([*command, f"-I{here}", "-o", target, code, "-lm"], check=True)


if __name__ == "__main__":
    library(Path(sys.argv[1]), Path(sys.argv[2]))
