//! The unit without links, as fast as the model runs.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use geu_model::configuration::LinkLogFormat;
use geu_model::fault::engine::FaultEngine;
use geu_model::{Configuration, Truth};

use crate::destination::Destination;
use crate::event::UnitEvent;
use crate::event_source::EventSource;
use crate::output::RecordError;
use crate::writer::Recorder;

/// Samples per batch: large enough that the hand-over costs nothing, small enough for the cache.
const BATCH: u64 = 128;
/// Capacity of the queue to the writer, batches.
const QUEUE: usize = 4;

/// Runs `samples` of the unit on `truth` into `recorder`, with the recorded commands of the configuration, and returns the
/// final state of faults and expectations.
///
/// The model runs on its own thread; the calling thread writes its events in their order. `progress` gets the number of
/// samples written, from time to time; if it returns false, the run ends with these.
///
/// # Errors
/// A file that cannot be written.
pub fn simulate(
    configuration: &Configuration,
    truth: &Truth,
    samples: u64,
    recorder: &mut Recorder,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<FaultEngine, RecordError> {
    thread::scope(|scope| {
        let (sender, batches) = sync_channel(QUEUE);
        let model = scope.spawn(move || run(configuration, truth, samples, &sender));
        let mut written = 0;
        // The end of the loop drops the receiver, which ends the model.
        for batch in batches {
            for event in batch {
                recorder.event(&event)?;
            }
            written = samples.min(written + BATCH);
            if !progress(written) {
                break;
            }
        }
        Ok(model.join().expect("the model does not panic"))
    })
}

/// Records `samples` of the configuration's scenario, with a link as CAN.
///
/// # Errors
/// A file cannot be written.
pub fn record(destination: &Destination, configuration: &Configuration, samples: u64) -> Result<(), RecordError> {
    let mut recorder = Recorder::create(destination, configuration, &Truth::Scenario, LinkLogFormat::Can, &[], None)?;
    simulate(configuration, &Truth::Scenario, samples, &mut recorder, |_| true)?;
    recorder.finish()
}

/// Runs the unit and sends its events, until the end or until the receiver is dropped.
fn run(configuration: &Configuration, truth: &Truth, samples: u64, sender: &SyncSender<Vec<UnitEvent>>) -> FaultEngine {
    let mut source = EventSource::new(configuration, truth);
    let mut batch = Vec::new();
    source.take_happened(&mut batch);
    // The sample that runs at the end never ends, but its commands are answered.
    for index in 0..=samples {
        source.repeat_recorded(&mut batch);
        if index < samples {
            source.end_sample(&mut batch);
        }
        let is_full = (index + 1).is_multiple_of(BATCH) || index == samples;
        if is_full && sender.send(std::mem::take(&mut batch)).is_err() {
            break;
        }
    }
    source.unit.faults().clone()
}
