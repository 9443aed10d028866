//! The unit without links, as fast as the model runs.

use geu_model::{Configuration, Truth, Unit};

use crate::record::{RecordError, Recorder};

/// Runs `half_seconds` of the unit on `truth` into `recorder`, with the commands its configuration recorded.
///
/// `progress` is told how many half seconds are done, now and then.
///
/// # Errors
/// A file that cannot be written.
pub fn simulate(
    configuration: &Configuration,
    truth: &Truth,
    half_seconds: u64,
    recorder: &mut Recorder,
    mut progress: impl FnMut(u64),
) -> Result<(), RecordError> {
    let mut unit = Unit::on(configuration, truth);
    let mut commands = configuration.run.commands.iter().peekable();
    let mut last_end_ns = 0;
    for index in 0..=half_seconds {
        while let Some(command) = commands.next_if(|command| command.half_second <= index) {
            recorder.command(&command.link, &command.payload, unit.running_end_ns())?;
            if let Some(polled) = unit.command(&command.payload).polled {
                recorder.polled(&polled, last_end_ns)?;
            }
        }
        // The one that ran at the end never ended, but its commands were answered.
        if index == half_seconds {
            break;
        }
        let (ended, traces) = unit.end_half_second_traced();
        recorder.half_second(&ended, &traces)?;
        last_end_ns = ended.end_ns;
        if index % 4096 == 0 {
            progress(index);
        }
    }
    progress(half_seconds);
    Ok(())
}
