"""Distributed particle SLAM: a particle filter over whole maps that share one grid."""
