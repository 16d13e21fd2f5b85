"""What a key scan does to the particles, on old ground and on new."""

import numpy as np

from drivers.world import Urg04lx, room
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.population import Population
from processing.dpslam.resampling import effective_size, normalise
from processing.dpslam.sweep import Sweeper
from processing.motion import Motion
from processing.scan import Scan
from tests.lasers import beams_of_laser

COVARIANCE = np.diag((0.03**2, 0.03**2, 0.01**2))


def population_and_sweep():
    """Particles that have written one scan of a room, and that scan again."""
    laser = Urg04lx()
    beams = beams_of_laser(laser)
    poses = np.tile((2.0, 1.5, 0.4), (laser.beams, 1))
    ranges_m = laser.measure(room(), poses, np.random.default_rng(1))
    config = DpSlamConfig(particles=20)
    sweep = Sweeper(beams, config.points, config.range_max_m).take(
        Scan(10**9, ranges_m, beams), Motion(10**9, np.zeros(3), COVARIANCE, np.zeros(3))
    )
    particles = Population(config, 3)
    particles.write(sweep.rays)
    return particles, sweep


def test_on_new_ground_no_particle_becomes_more_probable_than_another():
    particles, sweep = population_and_sweep()
    particles.update(sweep, np.zeros(3), COVARIANCE, False)
    np.testing.assert_array_equal(particles.log_weights, -np.log(20))
    # They spread all the same, but for the one that goes where the motion says.
    spread = np.ptp(particles.poses, axis=0)
    assert (spread > 0.0).all()
    assert particles.best == 0


def test_on_old_ground_those_that_fit_their_map_do():
    particles, sweep = population_and_sweep()
    particles.update(sweep, np.zeros(3), COVARIANCE, True)
    assert np.ptp(particles.log_weights) > 0.01


def test_a_selection_says_how_many_shared_the_weight_before_it():
    particles, sweep = population_and_sweep()
    particles.log_weights = normalise(-2.0 * np.arange(20.0))
    sharing, selected = particles.update(sweep, np.zeros(3), COVARIANCE, True)
    assert selected
    assert 1.0 <= sharing < 10.0
    assert effective_size(particles.log_weights) > sharing


def test_on_new_ground_they_go_on_sharing_what_lies_behind():
    particles, sweep = population_and_sweep()
    for _ in range(40):
        particles.update(sweep, np.zeros(3), COVARIANCE, False)
        particles.write(sweep.rays[:4])
    # Without a selection every particle would have a path of its own from the first key scan on.
    paths = [particles.ancestry.path(k) for k in range(20)]
    assert len(np.unique([path[20] for path in paths], axis=0)) <= 3
    assert len(np.unique([path[-1] for path in paths], axis=0)) > 8
