"""Surfaces as geometry: triangles made and checked, heights and normals in plan, lines laid on them."""
