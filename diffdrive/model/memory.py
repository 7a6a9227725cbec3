"""What a controller keeps from one period to the next: unit and meaning of each number, stated with its field.

    class LastError(NamedTuple):
        error: Annotated[Scalar, Memory("m", "position error one period ago")]

Exported code says so beside each number of its state. Of a field without it nothing is known.
"""

import inspect
from dataclasses import dataclass
from typing import get_args

import jax
from jax.tree_util import GetAttrKey, SequenceKey
from jaxtyping import PyTree


@dataclass(frozen=True)
class Memory:
    """Unit and meaning of a number, or of all numbers in a field; "" for a truth value's unit, or one stated around it.

    Where those of a tuple differ, the field has a tuple of these.
    """

    unit: str
    meaning: str


def memories(state: PyTree) -> list[Memory]:
    """Of each leaf of a state, in the order of `jax.tree.leaves`: the innermost statement; "" where there is none."""
    return [_stated(state, path) for path, _ in jax.tree_util.tree_flatten_with_path(state)[0]]


def _stated(node: PyTree, path: tuple[object, ...]) -> Memory:
    """By the fields on the way; a unit that is stated outside holds within."""
    stated: object = None
    unit = meaning = ""
    for key in path:
        if isinstance(key, GetAttrKey):
            stated = _of_field(type(node), key.name)
            node = getattr(node, key.name)
        elif isinstance(key, SequenceKey):
            stated = stated[key.idx] if isinstance(stated, tuple) else None
            node = node[key.idx]
        else:
            break
        if isinstance(stated, Memory):
            unit, meaning = stated.unit or unit, stated.meaning
    return Memory(unit, meaning)


def _of_field(owner: type, name: str) -> object:
    """What a field declares: a memory, or a tuple of them."""
    annotation = inspect.get_annotations(owner).get(name)
    return next((one for one in get_args(annotation)[1:] if isinstance(one, Memory | tuple)), None)
