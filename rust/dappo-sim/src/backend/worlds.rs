//! Worlds without episodes, observations or rewards, for tests and research.

use dappo_lanes::{Group, WorldAccess};

use super::Precision;
use super::lanes::LaneTable;
use crate::error::SimError;
use crate::simd::Simd;

/// N worlds of an engine.
pub trait Worlds: Send + Sync {
    /// A group of worlds, and the lane of a world in it.
    fn world(&self, index: usize) -> (&dyn WorldAccess, usize);

    /// A group of worlds, and the lane of a world in it.
    fn world_mut(&mut self, index: usize) -> (&mut dyn WorldAccess, usize);

    /// Computes the forces that act in the present states.
    ///
    /// # Errors
    /// If a device fails.
    fn forward(&mut self) -> Result<(), SimError>;

    /// Advances all worlds by a number of substeps.
    ///
    /// # Errors
    /// If a device fails.
    fn step(&mut self, substeps: usize) -> Result<(), SimError>;
}

/// Worlds of the lane engine, which compute in the thread that calls.
pub struct LaneWorlds {
    groups: Vec<Box<dyn Group>>,
    count: usize,
    width: usize,
}

impl LaneWorlds {
    /// `count` worlds of a table, all of class 0.
    ///
    /// # Errors
    /// If the processor lacks the instruction set.
    pub fn new(table: &LaneTable, precision: Precision, simd: Simd, count: usize) -> Result<Self, SimError> {
        let engine = table.engine(precision, simd)?;
        let width = engine.width();
        let groups = (0..count.div_ceil(width)).map(|_| engine.group()).collect();
        Ok(Self { groups, count, width })
    }

    /// The groups with the lanes that hold a world.
    fn groups(&mut self) -> impl Iterator<Item = (&mut Box<dyn Group>, u32)> {
        let (count, width) = (self.count, self.width);
        self.groups.iter_mut().enumerate().map(move |(index, group)| {
            let worlds = (count - index * width).min(width);
            (group, u32::MAX >> (u32::BITS - worlds as u32))
        })
    }
}

impl Worlds for LaneWorlds {
    fn world(&self, index: usize) -> (&dyn WorldAccess, usize) {
        (self.groups[index / self.width].as_ref(), index % self.width)
    }

    fn world_mut(&mut self, index: usize) -> (&mut dyn WorldAccess, usize) {
        (self.groups[index / self.width].as_mut(), index % self.width)
    }

    fn forward(&mut self) -> Result<(), SimError> {
        self.groups().for_each(|(group, lanes)| group.forward(lanes));
        Ok(())
    }

    fn step(&mut self, substeps: usize) -> Result<(), SimError> {
        self.groups().for_each(|(group, lanes)| group.step(lanes, substeps));
        Ok(())
    }
}
