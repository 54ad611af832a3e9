# SPDX-License-Identifier: Apache-2.0
"""Compute shaders: how they are run, and the sort that two stages share (GL 4.3)."""

from __future__ import annotations

from typing import Any, Mapping

import moderngl

from gscpe.render.shader_source import shader_source

THREADS = 256
_PER_THREAD = 4
BLOCK = THREADS * _PER_THREAD
SCAN_THREADS = 1024
_DIGIT_BITS = 4
DIGITS = 1 << _DIGIT_BITS
DEFINES = {"THREADS": THREADS, "PER_THREAD": _PER_THREAD, "BLOCK": BLOCK, "DIGITS": DIGITS}


class Programs:
    """Compiles compute shaders and runs them, one after the other.

    Args:
        context: with OpenGL 4.3 or later; it must be current in all calls.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self._owned: list[moderngl.ComputeShader] = []

    def compile(self, name: str, defines: Mapping[str, int]) -> moderngl.ComputeShader:
        """``shaders/<name>`` with these definitions."""
        program = self.context.compute_shader(shader_source(name, defines))
        self._owned.append(program)
        return program

    def run(
        self,
        program: moderngl.ComputeShader,
        groups: tuple[int, ...],
        buffers: Mapping[int, moderngl.Buffer],
        **uniforms: Any,
    ) -> None:
        """Queues workgroups; what they write is seen by whatever is queued later. Uniforms that
        the compiler has dropped are passed over."""
        for binding, buffer in buffers.items():
            buffer.bind_to_storage_buffer(binding)
        for name, value in uniforms.items():
            if name in program:
                program[name].value = value
        program.run(*groups)
        self.context.memory_barrier()

    def release(self) -> None:
        for program in self._owned:
            program.release()
        self._owned.clear()


class RadixSort:
    """A stable sort of (key, index) pairs on the GPU by ascending key, 4 bits a pass, least
    significant first. Only the GPU knows of how many pairs.

    Args:
        programs: the compiler.
        capacity: the most pairs.

    Attributes:
        keys, indices: the buffers that the pairs to sort are written to.
        capacity: see above.
    """

    def __init__(self, programs: Programs, capacity: int) -> None:
        self._programs = programs
        self._count_digits = programs.compile("radix_count.comp", DEFINES)
        self._scan = programs.compile("scan.comp", DEFINES | {"THREADS": SCAN_THREADS})
        self._scatter = programs.compile("radix_scatter.comp", DEFINES)
        self._scatter_last = programs.compile("radix_scatter.comp", DEFINES | {"LAST_PASS": 1})
        self._owned: list[moderngl.Buffer] = []
        self.reserve(capacity)

    def reserve(self, capacity: int) -> None:
        """Makes room for so many pairs; those that were there are lost."""
        self.release()
        self.capacity = capacity
        self._blocks = -(-capacity // BLOCK)
        self._counts = self._buffer(DIGITS * self._blocks)
        self._pairs = [[self._buffer(capacity) for _ in range(2)] for _ in range(2)]
        self.keys, self.indices = self._pairs[0]

    def _buffer(self, numbers: int) -> moderngl.Buffer:
        buffer = self._programs.context.buffer(reserve=4 * numbers)
        self._owned.append(buffer)
        return buffer

    def run(
        self,
        count: moderngl.Buffer,
        key_bits: int = 32,
        into_order: moderngl.Texture | None = None,
    ) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Queues the sort of as many pairs as the second number in ``count`` says.

        Args:
            key_bits: all higher bits of the keys are zero.
            into_order: the indices are written to this image instead, last one first.

        Returns:
            The buffers that hold the sorted keys and indices; without meaning with ``into_order``.
        """
        passes = max(1, -(-key_bits // _DIGIT_BITS))
        for number in range(passes):
            keys, indices = self._pairs[number % 2]
            keys_out, indices_out = self._pairs[1 - number % 2]
            bound = {0: keys, 1: self._counts, 4: count, 5: indices}
            shift = number * _DIGIT_BITS
            self._programs.run(self._count_digits, (self._blocks,), bound, shift=shift)
            self._programs.run(self._scan, (1,), {1: self._counts, 4: count})
            if into_order is not None and number == passes - 1:
                into_order.bind_to_image(0, read=False, write=True)
                program, last = self._scatter_last, {"order": 0}
            else:
                program, last = self._scatter, {}
                bound |= {2: keys_out, 3: indices_out}
            self._programs.run(program, (self._blocks,), bound, shift=shift, **last)
        keys, indices = self._pairs[passes % 2]
        return keys, indices

    def release(self) -> None:
        for buffer in self._owned:
            buffer.release()
        self._owned.clear()
