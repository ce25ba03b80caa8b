"""
Random numbers of the ray tree: points of scrambled Sobol' sequences, one for each start ray.

All rays of a batch that come to one node of the tree take their numbers from one sequence in two dimensions, I. M.
Sobol's (0, 2)-sequence (1967). Any 2^k neighbours along the curve of start points take points that lie evenly in the
unit square, so that directions and roulette vary less than with independent numbers. Each pair of numbers at each node
has a random order and a random scrambling of A. B. Owen (Randomly permuted (t, m, s)-nets and (t, s)-sequences, 1995)
of its own, made by hashing (B. Burley, Practical hash-based Owen scrambling, JCGT 9(4), 2020). So every number is
uniform, pairs are independent of each other, and batches are as well: their spread is the error.
"""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

GOLDEN = 0x9E3779B9  # steps between seeds of one node, odd
PARTS = ((1, 0xAAAAAAAA), (2, 0xCCCCCCCC), (4, 0xF0F0F0F0), (8, 0xFF00FF00), (16, 0xFFFF0000))
RESOLUTION = 24  # bits of a number, as many as a float32 has

# Pairs of random numbers of a node: for roulette among its children, and for the choice of one
BRANCH = 0
# Pairs of a scattered child: its event, with the connection or the technique of an only ray; its place on a lobe or a
# target; and which lobe or target it is, with the place in a cell of the lobe's table
EVENT, DIRECTION, TECHNIQUE = 1, 2, 3


class Sampler(NamedTuple):
    """
    Random numbers of the start rays at a node of their trees.

    Attributes
    ----------
    index : mi.UInt32
        Index of each start ray in the sequences of its batch.
    seed : mi.UInt32
        Seed of the node, the same for all rays of a batch that come to it.
    """

    index: mi.UInt32
    seed: mi.UInt32

    def child(self, number: mi.UInt32) -> Sampler:
        """Return the sampler of a node's child with the index `number`, also for the node that the child comes to."""
        return self._replace(seed=mixed_word(self.seed + (number + 1) * GOLDEN))

    def pair(self, number: int) -> tuple[mi.Float, mi.Float]:
        """Return two uniform random numbers, 0 … 1 without 1: the pair with the index `number` of this node."""
        seeds = [mixed_word(self.seed ^ ((3 * number + k + 1) * GOLDEN % 2**32)) for k in range(3)]
        # The order of the points: a shuffle that keeps aligned blocks of 2^k points together
        index = dr.brev(_scrambled(dr.brev(self.index), seeds[0]))
        first, second = (_scrambled(bits, seed) for bits, seed in zip((index, _pascal(index)), seeds[1:], strict=True))
        return _number(first), _number(second)


def tree_seeds(seed: int, group: mi.UInt32) -> mi.UInt32:
    """Return the seeds of the trees of start rays by the `seed` of the trace; rays of one `group` share sequences."""
    return mi.sample_tea_32(group, dr.opaque(mi.UInt32, seed % 2**32))[0]


def mixed_word(word: mi.UInt32) -> mi.UInt32:
    """Return a 32-bit hash of a word in which every bit depends on all bits of the word; steps as in MurmurHash3."""
    mixed = word * 0x85EBCA6B
    mixed = (mixed ^ (mixed >> 15)) * 0xC2B2AE35
    return mixed ^ (mixed >> 16)


def _scrambled(bits: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """
    Return words, the first bit of a fraction in the lowest place, after Owen's scrambling by a hash.

    Each bit is flipped by a hash of all bits before it. The steps are those of S. Laine and T. Karras (2011) with the
    constants of N. Vegdahl (2021).
    """
    bits = bits ^ (bits * 0x3D20ADEA)
    bits = (bits + seed) * ((seed >> 16) | 1)
    bits = bits ^ (bits * 0x05526C56)
    return bits ^ (bits * 0x53A22864)


def _pascal(bits: mi.UInt32) -> mi.UInt32:
    """
    Return the second coordinates of the points of the sequence, by their indices, the first bit in the lowest place.

    Bit j is the sum modulo 2 of the bits k ≥ j of the index times the binomial coefficients (k, j), which are odd where
    k has all bits of j.
    """
    for shift, part in PARTS:
        bits = bits ^ ((bits & part) >> shift)
    return bits


def _number(bits: mi.UInt32) -> mi.Float:
    """Return the fractions, 0 … 1 without 1, whose first bit is the lowest of a word."""
    return mi.Float(dr.brev(bits) >> (32 - RESOLUTION)) * 2.0**-RESOLUTION
