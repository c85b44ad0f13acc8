from carla_recap.sim.traffic.spawning import populate as populate
