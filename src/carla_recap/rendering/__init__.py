"""How a town and its actors look: surfaces, meshes, cameras, and the software renderer.

Units are m and radians unless said otherwise; axes are right-handed: x forward, y left, z up.
"""
