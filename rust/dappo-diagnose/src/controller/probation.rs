//! Whether an accepted diagnosis explains the robot.

use dappo_learn::statistics::upper_median;

use super::ControllerConfig;

/// The first steps under a new diagnosis: the twin has the diagnosed damage now, and must be closer to the
/// robot than the healthy twin in the diagnosis window was. Otherwise the robot is broken in a way that has no
/// class, and a wrong code can cost more than the healthy one.
#[derive(Debug)]
pub(super) struct Probation {
    /// Median residual of the healthy twin in the diagnosis window.
    healthy: f64,
    residuals: Vec<f64>,
}

/// Why a diagnosis is withdrawn: median residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rebuttal {
    /// Of the twin with the diagnosed damage.
    pub residual: f64,
    /// Of the healthy twin.
    pub healthy: f64,
}

impl Probation {
    /// Begins after a diagnosis window with these residuals of the healthy twin, one a step; `None` if there are none.
    pub fn new(config: &ControllerConfig, healthy: &[f64]) -> Option<Self> {
        let healthy = upper_median(healthy.iter().copied()).filter(|_| config.probation > 0)?;
        Some(Self { healthy, residuals: Vec::with_capacity(config.probation) })
    }

    /// Takes in a step. Once there are enough of them, the probation has been passed (`Ok`) or not.
    pub fn weigh(&mut self, config: &ControllerConfig, residual: f64) -> Option<Result<(), Rebuttal>> {
        self.residuals.push(residual);
        if self.residuals.len() < config.probation {
            return None;
        }
        let residual = upper_median(self.residuals.iter().copied())?;
        let healthy = self.healthy;
        Some(if residual < healthy { Ok(()) } else { Err(Rebuttal { residual, healthy }) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagnosis_passes_if_its_twin_is_closer_than_the_healthy_one_was() {
        let config = ControllerConfig { probation: 3, ..ControllerConfig::default() };
        let verdict = |residuals: [f64; 3]| {
            let mut probation = Probation::new(&config, &[0.1, 0.9, 0.4, 0.5]).unwrap();
            let mut verdicts = residuals.map(|residual| probation.weigh(&config, residual)).into_iter();
            assert_eq!((verdicts.next(), verdicts.next()), (Some(None), Some(None)));
            verdicts.next().flatten()
        };
        // The upper median of the healthy residuals is 0.5.
        assert_eq!(verdict([9.0, 0.4, 0.1]), Some(Ok(())));
        assert_eq!(verdict([9.0, 0.6, 0.1]), Some(Err(Rebuttal { residual: 0.6, healthy: 0.5 })));
        assert!(Probation::new(&config, &[]).is_none());
        assert!(Probation::new(&ControllerConfig { probation: 0, ..config }, &[0.1]).is_none());
    }
}
