//! One damage class: which limbs are damaged, and how.

/// One damaged limb.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Damage {
    /// Position of the limb in the ring.
    pub limb: usize,
    /// Index of the damage type in the space's list of types.
    pub kind: usize,
}

/// A set of damages; class 0 is healthy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamageClass {
    /// Position in the canonical order.
    pub id: usize,
    /// Damages in ascending order of limb, then type.
    pub damages: Vec<Damage>,
    /// `healthy` or `jammed_joint@0+missing_toe@2`.
    pub name: String,
    /// Group by number of damages, types and ring distance, as in the paper's bar charts.
    pub group: String,
}

impl DamageClass {
    /// The damage code, `[limbs · types]`: 1 for every (limb, type) that is damaged, 0 for the others.
    #[must_use]
    pub fn code(&self, limbs: usize, types: usize) -> Vec<f32> {
        let mut code = vec![0.0; limbs * types];
        for damage in &self.damages {
            code[damage.limb * types + damage.kind] = 1.0;
        }
        code
    }
}

/// `none`, `D1`, `D1_2 A` (adjacent limbs), `S` (in between), `O` (opposite) or `L` (the same limb); three and more damages
/// are grouped by their types alone.
pub(super) fn group(damages: &[Damage], limbs: usize) -> String {
    if damages.is_empty() {
        return "none".to_owned();
    }
    let mut types: Vec<usize> = damages.iter().map(|damage| damage.kind + 1).collect();
    types.sort_unstable();
    let types = types.iter().map(ToString::to_string).collect::<Vec<_>>().join("_");
    let [first, second] = damages else { return format!("D{types}") };
    let apart = second.limb - first.limb;
    let distance = apart.min(limbs - apart);
    let place = match distance {
        0 => "L",
        1 => "A",
        d if 2 * d == limbs => "O",
        _ => "S",
    };
    format!("D{types} {place}")
}
