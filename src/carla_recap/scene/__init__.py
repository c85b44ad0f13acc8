"""What is to be seen of a recording or of a running simulator: how actors look, what they do, and what is said of it.

Units are m and radians unless said otherwise; axes are right-handed: x forward, y left, z up.
"""
