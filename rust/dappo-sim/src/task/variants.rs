//! Compiled variants: what is random about a robot that only MuJoCo's compiler can compute, such as masses.
//!
//! The class table holds a model of every variant of every damage class. Which variant an episode has is drawn with its
//! other events. What the variants are is drawn once, from streams that depend on nothing but the robot file.

use serde::{Deserialize, Deserializer};

use crate::rng::{Purpose, Stream};

/// Number of variants of a robot with random bodies where the robot file has no `variants`.
const USUAL: usize = 16;

/// The entries of `[events]` that change bodies.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
pub struct BodyEvents {
    /// Lengths of links.
    #[serde(default, deserialize_with = "one_or_more")]
    link_length: Vec<BodyRange>,
    /// Masses and inertias.
    #[serde(default, deserialize_with = "one_or_more")]
    mass: Vec<BodyRange>,
    /// Centres of mass.
    #[serde(default, deserialize_with = "one_or_more")]
    center_of_mass: Vec<BodyRange>,
    /// Number of variants that are compiled.
    #[serde(default)]
    variants: Option<usize>,
}

/// Which bodies change, and the range of the change.
#[derive(Debug, Clone, PartialEq, Deserialize)]
struct BodyRange {
    /// Pattern of their names.
    bodies: String,
    #[serde(alias = "scale", alias = "offset")]
    range: [f64; 2],
}

/// A table, or a list of tables.
#[derive(Deserialize)]
#[serde(untagged)]
enum OneOrMore {
    One(BodyRange),
    More(Vec<BodyRange>),
}

fn one_or_more<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<BodyRange>, D::Error> {
    Ok(match OneOrMore::deserialize(deserializer)? {
        OneOrMore::One(one) => vec![one],
        OneOrMore::More(all) => all,
    })
}

/// A change of bodies, with its numbers in every variant.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyEvent {
    /// The entry of `[events]`.
    pub kind: &'static str,
    /// Pattern of the names of the bodies.
    pub bodies: String,
    /// Names of the numbers.
    pub names: Vec<String>,
    /// The numbers, `[variants][names]`.
    pub numbers: Vec<Vec<f64>>,
}

impl BodyEvents {
    /// The changes in the order in which they are applied: lengths, masses, centres of mass.
    ///
    /// A number has one value in each of as many equal parts of its range as there are variants, in an order of its own
    /// (Latin hypercube sampling; `McKay` et al., Technometrics 21, 1979). That of number i is drawn with key 0 and
    /// episode i.
    #[must_use]
    pub fn draw(&self) -> Vec<BodyEvent> {
        let count = self.variants.unwrap_or(USUAL);
        let kinds: [(&'static str, &[BodyRange], &[&str]); 3] = [
            ("link_length", &self.link_length, &[""]),
            ("mass", &self.mass, &[""]),
            ("center_of_mass", &self.center_of_mass, &[" x", " y", " z"]),
        ];
        let mut streams = (0..).map(|number| Stream::new(0, number, Purpose::VariantNumbers));
        let mut events = Vec::new();
        for (kind, entries, axes) in kinds {
            for BodyRange { bodies, range: [low, high] } in entries {
                let mut numbers = vec![Vec::with_capacity(axes.len()); count];
                for mut stream in streams.by_ref().take(axes.len()) {
                    let mut parts: Vec<usize> = (0..count).collect();
                    stream.shuffle(&mut parts);
                    for (variant, part) in numbers.iter_mut().zip(parts) {
                        let share = (part as f64 + stream.uniform()) / count as f64;
                        variant.push(low + (high - low) * share);
                    }
                }
                let names = axes.iter().map(|axis| format!("{kind} {bodies}{axis}")).collect();
                events.push(BodyEvent { kind, bodies: bodies.clone(), names, numbers });
            }
        }
        events
    }
}

/// The compiled models behind the damage classes of a robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Variants {
    /// Names of the numbers of a variant.
    pub names: Vec<String>,
    /// The numbers of each variant, `[variants][names]`; empty for a robot without variants.
    pub numbers: Vec<Vec<f64>>,
    /// Index of the model of each variant of each class, `[classes][variants]`; empty if each class has one model.
    pub models: Vec<Vec<usize>>,
    /// Limits of joints that move, `[models]`; empty if those of no model do.
    pub jams: Vec<Vec<Jam>>,
}

/// Limits of a joint that move with its position at the onset of the damage: it jams where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jam {
    /// Index of the joint.
    pub joint: usize,
    /// Its index in qpos.
    pub qpos: usize,
    /// Its index in qvel.
    pub dof: usize,
    /// Position for which the model was compiled, rad.
    pub compiled_at: f64,
    /// Lowest and highest position at which it jams, rad.
    pub range: [f64; 2],
    /// By how much the limits move, as a share of the distance from `compiled_at`.
    pub share: f64,
}

impl Jam {
    /// By how much the limits move, rad.
    fn shift(&self, qpos: &[f64]) -> f64 {
        let [low, high] = self.range;
        self.share * (qpos[self.qpos].max(low).min(high) - self.compiled_at)
    }
}

impl Variants {
    /// Number of variants, at least 1.
    #[must_use]
    pub fn count(&self) -> usize {
        self.numbers.len().max(1)
    }

    /// Most joints of a damage class whose limits move.
    pub(super) fn most_jams(&self) -> usize {
        self.jams.iter().map(Vec::len).max().unwrap_or(0)
    }

    /// The model of a variant of a damage class.
    pub(super) fn model(&self, class: usize, variant: usize) -> usize {
        self.models.get(class).map_or(class, |models| models[variant])
    }

    /// Writes by how much the limits of a model move for a robot at `qpos`.
    pub(super) fn jam(&self, model: usize, qpos: &[f64], shifts: &mut [f64]) {
        shifts.fill(0.0);
        for (shift, jam) in shifts.iter_mut().zip(self.jams.get(model).into_iter().flatten()) {
            *shift = jam.shift(qpos);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(text: &str) -> Vec<BodyEvent> {
        toml::from_str::<BodyEvents>(text).unwrap().draw()
    }

    #[test]
    fn each_part_of_a_range_has_one_variant_and_no_two_numbers_the_same_order() {
        let drawn = events(
            "variants = 8\nmass = [{ bodies = 'a', scale = [0.8, 1.6] }, { bodies = 'b', scale = [1, 9] }]\n\
             center_of_mass = { bodies = 'a', offset = [-0.04, 0.04] }\n",
        );
        let kinds: Vec<&str> = drawn.iter().map(|event| event.kind).collect();
        assert_eq!(kinds, ["mass", "mass", "center_of_mass"]);
        let spans = [[0.8, 1.6], [1.0, 9.0], [-0.04, 0.04], [-0.04, 0.04], [-0.04, 0.04]];
        let columns = drawn.iter().flat_map(|event| {
            (0..event.names.len()).map(|axis| event.numbers.iter().map(|row| row[axis]).collect::<Vec<_>>())
        });
        let mut orders = Vec::new();
        for (column, [low, high]) in columns.zip(spans) {
            let parts: Vec<usize> =
                column.iter().map(|number| ((number - low) / (high - low) * 8.0) as usize).collect();
            let mut sorted = parts.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..8).collect::<Vec<_>>());
            assert!(!orders.contains(&parts));
            orders.push(parts);
        }
        assert_eq!(orders.len(), 5);
        assert_eq!(drawn[2].names[1], "center_of_mass a y");
    }

    #[test]
    fn a_joint_jams_where_it_is_but_within_its_range() {
        let jam = Jam { joint: 0, qpos: 1, dof: 0, compiled_at: 0.5, range: [0.0, 1.0], share: 0.5 };
        let variants = Variants { jams: vec![vec![], vec![jam]], ..Variants::default() };
        let shift = |model: usize, position: f64| {
            let mut shifts = [f64::NAN; 2];
            variants.jam(model, &[9.0, position], &mut shifts);
            shifts
        };
        assert_eq!(shift(1, 0.75), [0.125, 0.0]);
        assert_eq!((shift(1, 3.0), shift(1, -1.0)), ([0.25, 0.0], [-0.25, 0.0]));
        assert_eq!(shift(0, 0.75), [0.0; 2]);
    }
}
