//! Named arrays of f32, as a safetensors file holds them.

use std::collections::BTreeMap;
use std::path::Path;

use burn::module::Param;
use burn::nn::Linear;
use burn::tensor::TensorData;
use dappo_learn::error::{FileKind, LearnError, Result};
use dappo_nn::error::check_length;
use dappo_nn::{cpu, read};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// An array in row-major order.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// Arrays by their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Tensors {
    arrays: BTreeMap<String, Array>,
}

impl Tensors {
    pub fn put(&mut self, name: &str, shape: &[usize], values: Vec<f32>) -> Result<()> {
        check_length("array of an export", &values, shape.iter().product())?;
        self.arrays.insert(name.into(), Array { shape: shape.to_vec(), values });
        Ok(())
    }

    /// Adds `NAME.weight`, `[inputs, outputs]`, and `NAME.bias`, `[outputs]`.
    pub fn put_linear(&mut self, name: &str, layer: &Linear) -> Result<()> {
        let [inputs, outputs] = layer.weight.lazy_shape().dims();
        let bias = layer.bias.as_ref().map_or_else(|| Ok(vec![0.0; outputs]), |bias| read(bias.val()))?;
        self.put(&format!("{name}.weight"), &[inputs, outputs], read(layer.weight.val())?)?;
        self.put(&format!("{name}.bias"), &[outputs], bias)
    }

    pub fn get(&self, name: &str) -> Result<&Array> {
        self.arrays.get(name).ok_or_else(|| LearnError::Invalid(format!("there is no array `{name}`")))
    }

    /// Bytes of a safetensors file.
    pub fn to_bytes(&self, path: &Path) -> Result<Vec<u8>> {
        let bytes = |array: &Array| array.values.iter().flat_map(|x| x.to_le_bytes()).collect();
        let data: Vec<Vec<u8>> = self.arrays.values().map(bytes).collect();
        let views = self.arrays.iter().zip(&data).map(|((name, array), data)| {
            TensorView::new(Dtype::F32, array.shape.clone(), data).map(|view| (name.as_str(), view))
        });
        let views: std::result::Result<Vec<_>, _> = views.collect();
        views
            .and_then(|views| safetensors::serialize(views, None))
            .map_err(|error| FileKind::Export.unusable(path, error))
    }
}

/// The arrays of a safetensors file, each to be taken by its name and shape.
pub(super) struct Reader<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl<'a> Reader<'a> {
    pub fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| FileKind::Export.unusable(path, error))?;
        Ok(Self { path, file })
    }

    pub fn array(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let view = self.file.tensor(name).map_err(|error| FileKind::Export.unusable(self.path, error))?;
        if view.dtype() != Dtype::F32 || view.shape() != shape {
            let (dtype, found) = (view.dtype(), view.shape());
            let message = format!("`{name}` is {dtype} {found:?}, expected F32 {shape:?}");
            return Err(FileKind::Export.unusable(self.path, message));
        }
        let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let values: Vec<f32> = view.data().chunks_exact(4).map(number).collect();
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            return Err(FileKind::Export
                .unusable(self.path, format!("`{name}` holds {value}, expected finite numbers")));
        }
        Ok(values)
    }

    /// Blames the file for what does not fit its arrays.
    pub fn blame(&self, error: impl std::fmt::Display) -> LearnError {
        FileKind::Export.unusable(self.path, error)
    }

    /// What [`Tensors::put_linear`] added.
    pub fn linear(&self, name: &str, inputs: usize, outputs: usize) -> Result<Linear> {
        let weight = self.array(&format!("{name}.weight"), &[inputs, outputs])?;
        let bias = self.array(&format!("{name}.bias"), &[outputs])?;
        Ok(Linear {
            weight: Param::from_data(TensorData::new(weight, [inputs, outputs]), &cpu()),
            bias: Some(Param::from_data(TensorData::new(bias, [outputs]), &cpu())),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(bytes: &[u8], name: &str, shape: &[usize]) -> String {
        let path = Path::new("weights.safetensors");
        Reader::new(path, bytes).and_then(|file| file.array(name, shape)).unwrap_err().to_string()
    }

    #[test]
    fn arrays_read_back_to_the_bit_by_name_and_shape() {
        let (path, values) =
            (Path::new("weights.safetensors"), vec![0.1, -f32::MIN_POSITIVE, 3e38, 0.0, 1.0, 2.0]);
        let mut tensors = Tensors::default();
        tensors.put("b", &[2, 3], values.clone()).unwrap();
        tensors.put("a", &[1], vec![f32::NAN]).unwrap();
        assert!(tensors.put("c", &[2], vec![1.0]).is_err());
        let bytes = tensors.to_bytes(path).unwrap();
        assert_eq!(Reader::new(path, &bytes).unwrap().array("b", &[2, 3]).unwrap(), values);
        assert!(refusal(&bytes, "b", &[3, 2]).contains("`b` is F32 [2, 3], expected F32 [3, 2]"));
        assert!(refusal(&bytes, "a", &[1]).contains("`a` holds NaN"));
        assert!(refusal(&bytes, "c", &[1]).contains("`c`"));
        assert!(refusal(&bytes[..20], "b", &[2, 3]).contains("weights.safetensors"));
    }
}
