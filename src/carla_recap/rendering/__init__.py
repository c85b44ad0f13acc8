"""How towns and actors look: cameras, the software renderer, and rays.

Units are m and radians unless said otherwise; axes are right-handed: x forward, y left, z up.
"""
