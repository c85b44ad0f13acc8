"""Planar rigid bodies of vehicles and walkers: engines, tyres and contacts."""
