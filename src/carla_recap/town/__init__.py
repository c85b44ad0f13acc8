"""Towns as triangle meshes, made of OpenDRIVE maps: surfaces, markings, what stands beside the road, and the ground.

Units are m and radians unless said otherwise; axes are right-handed: x forward, y left, z up.
"""
