"""Cached results of Python calculations, without keeping their diagrams alive.

A bound method or a cache entry held by a system makes a cycle through C++ that Python's garbage
collector cannot see; a diagram with one is never freed.
"""

import weakref
from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import CacheIndex, Context, DependencyTicket, ValueProducer


@dataclass(frozen=True)
class Cached:
    """A declared cache entry.

    Attributes:
        index: of the entry in its system.
        ticket: for the prerequisites of what uses it.
    """

    index: CacheIndex
    ticket: DependencyTicket

    def of(self, system: Any, context: Context) -> Any:
        """The object, calculated anew if something it depends on has changed."""
        return system.get_cache_entry(self.index).Eval(context)


def declare_cached(
    system: Any,
    name: str,
    calc: Callable[[Context], Any],
    prerequisites_of_calc: Set[DependencyTicket],
) -> Cached:
    """Declares a cache entry for the object that the system's method `calc` returns."""
    reference = weakref.WeakMethod(calc)

    def produce(context: Any, value: Any) -> None:
        method = reference()
        assert method is not None
        value.set_value(method(context))

    producer = ValueProducer(Value[object], produce)
    entry = system.DeclareCacheEntry(name, producer, prerequisites_of_calc)
    return Cached(entry.cache_index(), entry.ticket())
