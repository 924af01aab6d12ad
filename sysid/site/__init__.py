"""The workspace as a site of static pages: datasets, gaps, plants, networks and policies, linked by their lineage."""

from sysid.site.build import Built, build_site
from sysid.site.inventory import inventory
from sysid.site.item import Fact, Item

__all__ = ["Built", "Fact", "Item", "build_site", "inventory"]
