"""The lake: content-addressed artefacts, committed by manifests, in a local folder or an object store."""

from storage.keys import recipe_key
from storage.lake import Lake
from storage.manifests import Manifest, Recipe

__all__ = ["Lake", "Manifest", "Recipe", "recipe_key"]
