//! Files of networks and optimisers.

use std::path::Path;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use dappo_nn::records;

use crate::error::{FileKind, LearnError, Result};
use crate::files::{Files, write_new};

/// Writes the file of a module, which must not be there yet.
pub fn save_module<M: Module>(module: &M, path: &Path) -> Result<()> {
    write_new(path, &records::module_bytes(module).map_err(|error| unreadable(path, error))?)
}

/// Writes the file of an optimiser, which must not be there yet.
pub fn save_optimizer(optimizer: &ModuleOptimizer, path: &Path) -> Result<()> {
    write_new(path, &records::optimizer_bytes(optimizer).map_err(|error| unreadable(path, error))?)
}

/// Reads the file of a module of this many numbers; `None` stands for more than can be counted. The file must
/// hold them: what is made from its sizes takes no more memory than the file itself.
pub fn read_numbers<F: Files + ?Sized>(files: &F, name: &str, numbers: Option<usize>) -> Result<Vec<u8>> {
    let path = files.path(name);
    let [fewest, most] = records::module_size(numbers).map_err(|error| unreadable(&path, error))?;
    let bytes = files.read(name, most)?;
    if (bytes.len() as u64) < fewest {
        let message = format!("it has {} bytes, expected at least {fewest} for its sizes", bytes.len());
        return Err(unreadable(&path, message));
    }
    Ok(bytes)
}

/// Replaces the parameters of `module` by those of a file.
pub fn load_module<M: Module>(module: M, path: &Path, bytes: Vec<u8>) -> Result<M> {
    records::load_module(module, bytes).map_err(|error| unreadable(path, error))
}

/// Replaces the state of `fresh`, an Adam of the same settings, by that of a file. The state is that of the parameters
/// of `module`.
pub fn load_optimizer<M: Module, F: Files + ?Sized>(
    fresh: ModuleOptimizer,
    module: &M,
    files: &F,
    name: &str,
) -> Result<ModuleOptimizer> {
    let bytes = files.read(name, records::optimizer_size(module))?;
    records::load_optimizer(fresh, module, bytes).map_err(|error| unreadable(&files.path(name), error))
}

/// Turns what a reader or writer reports of a file into an error that names it.
pub fn unreadable(path: &Path, error: impl std::fmt::Display) -> LearnError {
    FileKind::Checkpoint.unusable(path, error)
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};
    use dappo_nn::cpu;

    use super::*;
    use crate::files::testing::Scratch;

    fn fresh() -> Linear {
        LinearConfig::new(3, 2).init(&cpu())
    }

    #[test]
    fn files_that_do_not_hold_the_numbers_of_their_sizes_are_rejected_before_memory_is_taken() {
        let scratch = Scratch::new();
        save_module(&fresh(), &scratch.0.join("net")).unwrap();
        read_numbers(scratch.0.as_path(), "net", Some(8)).unwrap();
        let refuse = |numbers| read_numbers(scratch.0.as_path(), "net", numbers).unwrap_err().to_string();
        assert!(refuse(None).contains("net: its sizes are beyond all memory"));
        assert!(refuse(Some(1 << 40)).contains("expected at least 4398046511104 for its sizes"));
        std::fs::File::options().write(true).open(scratch.0.join("net")).unwrap().set_len(1 << 41).unwrap();
        assert!(refuse(Some(8)).contains("more than the"));
    }

    #[test]
    fn a_file_that_is_no_record_is_named() {
        let path = Path::new("checkpoint/net");
        let message = load_module(fresh(), path, vec![0; 100]).unwrap_err().to_string();
        assert!(message.starts_with("checkpoint checkpoint/net: "), "{message}");
    }
}
