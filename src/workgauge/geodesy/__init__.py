"""Coordinate systems, grid convergence, point scale and the site's local frame; the only importer of pyproj."""
