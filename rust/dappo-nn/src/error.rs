//! What can go wrong with networks and their inputs. Every message contains what was read, what was got and
//! what was expected.

/// The result of a fallible operation of this crate.
pub type Result<T> = std::result::Result<T, NnError>;

/// An error of a network.
#[derive(Debug, thiserror::Error)]
pub enum NnError {
    /// An array does not have the length that its neighbours imply.
    #[error("{what} has {got} elements, expected {expected}")]
    Length {
        /// The array and its shape in words.
        what: &'static str,
        /// Elements found.
        got: usize,
        /// Elements needed.
        expected: usize,
    },
    /// A setting lies outside its range, or names something unknown.
    #[error("{key} is {got}, expected {expected}")]
    Config {
        /// Name of the setting.
        key: &'static str,
        /// The value found.
        got: String,
        /// The range or the choices.
        expected: &'static str,
    },
    /// Parts that do not fit each other, or a device that cannot be used.
    #[error("{0}")]
    Invalid(String),
    /// A number that must be finite is not.
    #[error("{what} is {got}, expected a finite number")]
    NonFinite {
        /// The quantity.
        what: String,
        /// NaN or an infinity.
        got: f64,
    },
    /// A tensor could not be read from its device.
    #[error("cannot read a tensor of f32: {message}")]
    Tensor {
        /// What burn reported.
        message: String,
    },
    /// The bytes of a network or an optimiser cannot be understood.
    #[error("{0}")]
    Record(String),
}

/// Fails unless `array` has `expected` elements.
pub fn check_length<T>(what: &'static str, array: &[T], expected: usize) -> Result<()> {
    if array.len() == expected {
        return Ok(());
    }
    Err(NnError::Length { what, got: array.len(), expected })
}

/// Fails unless `value` is finite.
pub fn check_finite(what: impl Into<String>, value: f64) -> Result<f64> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(NnError::NonFinite { what: what.into(), got: value })
}
