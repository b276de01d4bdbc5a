//! The loss `e·e` of a method around the desired pose: the camera shifted along x and y, not turned, one image for each shift.
//!
//! How wide a landscape draws the camera home is one number here, its *basin*: the share of the shifts from which the steepest
//! way down, from neighbour to neighbour of eight, ends at the desired pose.

use domvs_proto::settings::TaskSettings;
use domvs_simulators::Simulation;
use nalgebra::Translation3;
use serde::{Deserialize, Serialize};

use super::plan::RunPlan;
use super::runner::{frame, settings};
use super::service::{InProcess, Service};
use super::world::Worlds;

/// Over which shifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The largest shift to each side, m.
    pub reach_m: f64,
    /// Shifts along each axis, odd, so that one is none.
    pub steps: usize,
}

impl Grid {
    /// The shift with this index, m.
    pub fn shift_m(&self, index: usize) -> f64 {
        self.reach_m * (2.0 * index as f64 / (self.steps - 1) as f64 - 1.0)
    }

    fn middle(&self) -> usize {
        let half = self.steps / 2;
        half * self.steps + half
    }
}

/// The loss of one method over a grid, row by row from the smallest y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Landscape {
    /// The scene's name.
    pub scene: String,
    /// The method's name.
    pub method: String,
    /// `e·e`; none where the method has no answer.
    #[serde(skip)]
    pub loss: Vec<f64>,
    /// The share of the shifts from which the way down leads home.
    pub basin: f64,
    /// Shifts without a lower neighbour, other than none at all.
    pub local_minima: usize,
    /// The loss at a twentieth of the reach along x over the largest: how steep it is at home.
    pub near_share: f64,
}

/// Computes the landscape of a plan's method in its world; the plan's start does not matter.
///
/// # Errors
/// Fails when the world or the settings are impossible, or the service refuses the target.
pub fn landscape(plan: &RunPlan, worlds: &Worlds, grid: Grid) -> anyhow::Result<Landscape> {
    let mut world = worlds.open(plan)?;
    let settings: TaskSettings = settings(plan, &world)?;
    let simulation = &mut world.simulation;
    let mut service = InProcess::default();
    let desired = simulation.capture_desired();
    if let Some(code) = service.begin(&settings, &frame(&desired, 0)?)? {
        anyhow::bail!("the target was refused: {code}");
    }
    let mut loss = Vec::with_capacity(grid.steps * grid.steps);
    for row in 0..grid.steps {
        for column in 0..grid.steps {
            loss.push(loss_at(&mut service, simulation, [grid.shift_m(column), grid.shift_m(row)])?);
        }
    }
    let near = loss_at(&mut service, simulation, [grid.reach_m / 20.0, 0.0])?;
    let largest = loss.iter().copied().filter(|loss| loss.is_finite()).fold(f64::MIN_POSITIVE, f64::max);
    Ok(Landscape {
        scene: plan.cell.scene.clone(),
        method: plan.cell.method.clone(),
        basin: basin(&loss, grid),
        local_minima: local_minima(&loss, grid),
        near_share: near / largest,
        loss,
    })
}

fn loss_at(service: &mut InProcess, simulation: &mut Simulation, [x, y]: [f64; 2]) -> anyhow::Result<f64> {
    simulation.pose = simulation.desired * Translation3::new(x, y, 0.0);
    let answer = service.ask_afresh(&frame(&simulation.capture(), 1)?)?;
    Ok(answer.feature_error_norm.powi(2))
}

/// The lowest of the eight neighbours that is lower than `at`, if one is.
fn downhill(loss: &[f64], grid: Grid, at: usize) -> Option<usize> {
    let (row, column) = ((at / grid.steps) as isize, (at % grid.steps) as isize);
    let steps = grid.steps as isize;
    let mut best: Option<usize> = None;
    for (dv, du) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
        let (v, u) = (row + dv, column + du);
        if !(0..steps).contains(&v) || !(0..steps).contains(&u) {
            continue;
        }
        let neighbour = (v * steps + u) as usize;
        if loss[neighbour] < loss[best.unwrap_or(at)] {
            best = Some(neighbour);
        }
    }
    best
}

/// The share of the points whose steepest way down ends in the middle.
fn basin(loss: &[f64], grid: Grid) -> f64 {
    let home = |start: usize| {
        // Every step is lower than the one before, so it ends.
        let mut at = start;
        while let Some(next) = downhill(loss, grid, at) {
            at = next;
        }
        at == grid.middle()
    };
    (0..loss.len()).filter(|&start| home(start)).count() as f64 / loss.len() as f64
}

fn local_minima(loss: &[f64], grid: Grid) -> usize {
    let is_minimum = |at: usize| at != grid.middle() && loss[at].is_finite() && downhill(loss, grid, at).is_none();
    (0..loss.len()).filter(|&at| is_minimum(at)).count()
}

#[cfg(test)]
mod tests {
    use super::super::plan::Overrides;
    use super::super::spec::Experiment;
    use super::*;

    const GRID: Grid = Grid { reach_m: 1.0, steps: 9 };

    #[test]
    fn a_bowl_is_all_basin_and_a_second_pit_takes_its_part() {
        let shift = |i: usize| (GRID.shift_m(i % 9), GRID.shift_m(i / 9));
        let bowl: Vec<f64> = (0..81).map(shift).map(|(x, y)| x * x + y * y).collect();
        assert_eq!((basin(&bowl, GRID), local_minima(&bowl, GRID)), (1.0, 0));
        let two: Vec<f64> = (0..81).map(shift).map(|(x, y)| (x * x).min((x - 1.0).powi(2) + 0.1) + y * y).collect();
        assert!(basin(&two, GRID) < 0.8 && local_minima(&two, GRID) == 1);
    }

    #[test]
    fn the_loss_is_nothing_at_home_and_grows_around_it() {
        let text = "name = 'x'\nmethods = ['TM']\n[camera]\nwidth = 48\nheight = 48\n[settings]\norder = 4";
        let plan = Experiment::parse(text).expect("a file").plan(&Overrides::default()).expect("a plan").remove(0);
        let grid = Grid { reach_m: 0.1, steps: 5 };
        let landscape = landscape(&plan, &Worlds::default(), grid).expect("a landscape");
        assert_eq!(landscape.loss[grid.middle()], 0.0);
        assert_eq!(landscape.basin, 1.0, "{landscape:?}");
        assert!(landscape.near_share > 0.0 && landscape.near_share < 0.1);
    }
}
