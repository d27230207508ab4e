"""All effects, found by scanning this folder: a new effect is a new module in it."""

import functools
import importlib
import pkgutil

import drd.effects
from drd.effects.effect import ActsOn, Effect, Symptom


@functools.cache
def catalogue() -> dict[str, Effect]:
    """The effects by name, in the order in which they act: geometry first among the wheels', then by name."""
    found: list[Effect] = []
    for module in pkgutil.iter_modules(drd.effects.__path__):
        effect = getattr(importlib.import_module(f"drd.effects.{module.name}"), "EFFECT", None)
        if effect is not None:
            assert effect.id == module.name
            found.append(effect)
    order = list(ActsOn)
    return {effect.id: effect for effect in sorted(found, key=lambda e: (order.index(e.acts_on), not e.geometry, e.id))}


def acting_order(effect: Effect) -> int:
    """Position of an effect in the order in which the effects act."""
    return list(catalogue()).index(effect.id)


def showing(symptom: Symptom) -> Effect:
    """The effect that shows this symptom in raw readings."""
    return next(effect for effect in catalogue().values() if effect.symptom is symptom)
