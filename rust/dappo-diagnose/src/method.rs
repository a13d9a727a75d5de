//! What the network sees of a window at every time step.

use dappo_learn::error::Result;
use dappo_nn::error::check_length;
use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

use super::Window;

/// The choice of a time step's input. `A` and `B` are the paper's.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, EnumString, IntoStaticStr, VariantNames,
)]
pub enum Method {
    /// The damaged robot's observation, `o_d`.
    A,
    /// What the healthy twin observes beyond it, `o_h − o_d`.
    B,
    /// `o_d`, then `o_h − o_d`.
    C,
    /// `o_d`, `o_h − o_d`, and the damaged robot's action.
    D,
}

impl Method {
    /// Its name, a letter.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Numbers of one time step, F.
    #[must_use]
    pub fn input_dim(self, obs_dim: usize, action_dim: usize) -> usize {
        match self {
            Self::A | Self::B => obs_dim,
            Self::C => 2 * obs_dim,
            Self::D => 2 * obs_dim + action_dim,
        }
    }

    /// Writes the inputs of a window of observations of `obs_dim` numbers.
    ///
    /// # Shapes
    /// out `[T, F]`
    pub fn write(self, window: &Window, obs_dim: usize, action_dim: usize, out: &mut [f32]) -> Result<()> {
        let width = self.input_dim(obs_dim, action_dim);
        let steps = out.len() / width.max(1);
        check_length("inputs [T, F]", out, steps * width)?;
        check_length("observations of the damaged robot [T, O]", &window.damaged, steps * obs_dim)?;
        if self != Self::A {
            check_length("observations of the healthy twin [T, O]", &window.twin, steps * obs_dim)?;
        }
        if self == Self::D {
            check_length("actions of the damaged robot [T, A]", &window.actions, steps * action_dim)?;
        }
        for (step, row) in out.chunks_exact_mut(width.max(1)).enumerate() {
            let damaged = &window.damaged[step * obs_dim..][..obs_dim];
            let (own, rest) = row.split_at_mut(if self == Self::B { 0 } else { obs_dim });
            own.copy_from_slice(&damaged[..own.len()]);
            if self == Self::A {
                continue;
            }
            let twin = &window.twin[step * obs_dim..][..obs_dim];
            let (difference, action) = rest.split_at_mut(obs_dim);
            for ((out, twin), damaged) in difference.iter_mut().zip(twin).zip(damaged) {
                *out = twin - damaged;
            }
            if self == Self::D {
                action.copy_from_slice(&window.actions[step * action_dim..][..action_dim]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window() -> Window {
        Window {
            damaged: vec![1.0, 2.0, 3.0, 4.0],
            twin: vec![10.0, 20.0, 30.0, 40.0],
            actions: vec![0.5, -0.5],
        }
    }

    fn inputs(method: Method) -> Vec<f32> {
        let mut out = vec![f32::NAN; 2 * method.input_dim(2, 1)];
        method.write(&window(), 2, 1, &mut out).unwrap();
        out
    }

    #[test]
    fn every_method_lays_out_its_inputs_step_by_step() {
        assert_eq!(inputs(Method::A), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(inputs(Method::B), [9.0, 18.0, 27.0, 36.0]);
        assert_eq!(inputs(Method::C), [1.0, 2.0, 9.0, 18.0, 3.0, 4.0, 27.0, 36.0]);
        assert_eq!(inputs(Method::D), [1.0, 2.0, 9.0, 18.0, 0.5, 3.0, 4.0, 27.0, 36.0, -0.5]);
    }

    #[test]
    fn windows_that_lack_what_a_method_needs_are_rejected_by_name() {
        let lacking = Window { twin: vec![1.0], actions: Vec::new(), ..window() };
        let refuse = |method: Method| {
            let mut out = vec![0.0; 2 * method.input_dim(2, 1)];
            method.write(&lacking, 2, 1, &mut out).err().map(|error| error.to_string())
        };
        assert_eq!(refuse(Method::A), None);
        let message = refuse(Method::B).unwrap();
        assert_eq!(message, "observations of the healthy twin [T, O] has 1 elements, expected 4");
    }
}
