//! What simulated a result.

use dappo_sim::Physics;
use serde::ser::{Serialize, SerializeStruct, Serializer};

/// The simulator behind a result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Simulator {
    /// What simulated.
    pub physics: Physics,
    /// Integrator, as MuJoCo names it.
    pub integrator: String,
}

impl Simulator {
    /// Names of the columns that every table of results ends with.
    pub const COLUMNS: [&str; 4] = ["backend", "precision", "device", "physics"];

    /// The entries of these columns.
    #[must_use]
    pub fn cells(&self) -> [String; 4] {
        let Self { physics, integrator } = self;
        [physics.backend(), physics.precision(), physics.device(), integrator].map(ToOwned::to_owned)
    }
}

impl Serialize for Simulator {
    /// The names of the columns, each with its entry.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut entries = serializer.serialize_struct("Simulator", 4)?;
        entries.serialize_field("backend", self.physics.backend())?;
        entries.serialize_field("precision", self.physics.precision())?;
        entries.serialize_field("device", self.physics.device())?;
        entries.serialize_field("physics", &self.integrator)?;
        entries.end()
    }
}

#[cfg(test)]
mod tests {
    use dappo_sim::{Precision, WarpDevice};

    use super::*;

    #[test]
    fn results_record_the_same_in_columns_and_in_json() {
        for (physics, cells) in [
            (Physics::Lanes(Precision::F32), "lanes,f32,cpu,rk4"),
            (Physics::Mujoco, "mujoco,f64,cpu,rk4"),
            (Physics::Warp(WarpDevice::Cuda), "warp,f32,cuda,rk4"),
        ] {
            let simulator = Simulator { physics, integrator: "rk4".into() };
            assert_eq!(simulator.cells().join(","), cells);
            let json = serde_json::to_value(&simulator).unwrap();
            for (name, cell) in Simulator::COLUMNS.into_iter().zip(cells.split(',')) {
                assert_eq!(json[name], cell);
            }
        }
    }
}
