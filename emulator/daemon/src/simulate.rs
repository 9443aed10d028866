//! The unit without links, as fast as the model runs.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use geu_model::fault::acting::Faults;
use geu_model::{Configuration, Truth, Unit};

use crate::recorder::{RecordError, Recorder, UnitEvent};

/// Half seconds handed over at a time: enough that handing over costs nothing, few enough that they stay in the cache.
const BATCH: u64 = 128;
/// Batches that may wait to be written.
const QUEUE: usize = 4;

/// Runs `half_seconds` of the unit on `truth` into `recorder`, with the commands its configuration recorded; how its
/// faults and expectations stand then.
///
/// The model runs on a thread of its own; this one writes what it tells, in its order. `progress` is told how many half
/// seconds are written, now and then, and says whether to go on: where not, the run ends with those.
///
/// # Errors
/// A file that cannot be written.
pub fn simulate(
    configuration: &Configuration,
    truth: &Truth,
    half_seconds: u64,
    recorder: &mut Recorder,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<Faults, RecordError> {
    thread::scope(|scope| {
        let (sender, batches) = sync_channel(QUEUE);
        let flight = scope.spawn(move || fly(configuration, truth, half_seconds, &sender));
        let mut written = 0;
        // Who leaves the loop drops the receiver, which ends the model.
        for batch in batches {
            for event in batch {
                recorder.event(&event)?;
            }
            written = half_seconds.min(written + BATCH);
            if !progress(written) {
                break;
            }
        }
        Ok(flight.join().expect("the model does not panic"))
    })
}

/// Flies the unit and tells all that happens, until the end or until nobody listens.
fn fly(configuration: &Configuration, truth: &Truth, half_seconds: u64, sender: &SyncSender<Vec<UnitEvent>>) -> Faults {
    let mut unit = Unit::on(configuration, truth);
    let mut commands = configuration.run.commands.iter().peekable();
    let mut last_end_ns = 0;
    let happened = |unit: &mut Unit| unit.take_happened().into_iter().map(UnitEvent::Happened).collect::<Vec<_>>();
    let mut batch = happened(&mut unit);
    // The half second that runs at the end never ends, but its commands are answered.
    for index in 0..=half_seconds {
        while let Some(command) = commands.next_if(|command| command.half_second <= index) {
            let (link, payload, running_end_ns) = (&command.link, &command.payload, unit.running_end_ns());
            let (answer, acting) = (unit.command(payload), unit.faults().acting().clone());
            batch.push(UnitEvent::Command {
                link: link.clone(),
                payload: payload.clone(),
                running_end_ns,
                reply: answer.map(|answer| answer.reply),
                acting: acting.clone(),
            });
            let Ok(answer) = answer else { continue };
            let (link, reply, end_ns, injected) = (link.clone(), answer.reply, last_end_ns, unit.injected().cloned());
            let polled = |half_second| UnitEvent::Polled { link, half_second, reply, end_ns, injected, acting };
            batch.extend(answer.polled.map(polled));
        }
        if index < half_seconds {
            let (ended, traces) = unit.end_half_second_traced();
            last_end_ns = ended.end_ns;
            batch.push(UnitEvent::HalfSecond(ended, Box::new(traces), unit.injected().cloned()));
            batch.extend(happened(&mut unit));
        }
        let is_full = (index + 1).is_multiple_of(BATCH) || index == half_seconds;
        if is_full && sender.send(std::mem::take(&mut batch)).is_err() {
            break;
        }
    }
    unit.faults().clone()
}
