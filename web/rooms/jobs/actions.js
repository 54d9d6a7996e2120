// Actions for jobs, one or many at once: which apply, the question before, and the message after.

import { Problem, getJson, messageOf, send } from '/ui/api.js';
import { confirm, showDialog } from '/ui/parts/dialog.js';
import { h } from '/ui/parts/dom.js';
import { counted, percent, size } from '/ui/parts/format.js';
import { toast, toastError } from '/ui/parts/toast.js';
import { session } from '/ui/session.js';

/** @typedef {import('/ui/types.js').Job} Job */
/** @typedef {'pause' | 'resume' | 'cancel' | 'retry' | 'priority' | 'first' | 'move' | 'delete'} ActionName */
/** @typedef {{changed: (job: Job | null) => void, deleted: (id: string) => void, others?: () => Job[]}} Effects */

const AT_ONCE = 4;
const LISTED = 6;

/** @param {Job} job */
const isUnfinished = (job) => job.state === 'queued' || job.state === 'running';

/** @type {Record<ActionName, {label: string, done: string, icon: import('/ui/parts/icons.js').IconName, applies: (job: Job) => boolean}>} */
export const ACTIONS = {
  pause: { label: 'Pause', done: 'Paused', icon: 'pause', applies: (job) => isUnfinished(job) && !job.paused },
  resume: { label: 'Resume', done: 'Resumed', icon: 'play', applies: (job) => isUnfinished(job) && job.paused },
  cancel: { label: 'Cancel', done: 'Cancelled', icon: 'stop', applies: isUnfinished },
  retry: { label: 'Retry', done: 'Retried', icon: 'again', applies: (job) => job.state === 'failed' },
  priority: { label: 'Priority', done: 'Changed the priority of', icon: 'flag', applies: isUnfinished },
  first: { label: 'To the front', done: 'Moved to the front:', icon: 'top', applies: isUnfinished },
  move: { label: 'Move', done: 'Moved', icon: 'up', applies: isUnfinished },
  delete: { label: 'Delete', done: 'Deleted', icon: 'trash', applies: () => true },
};

/**
 * Whether an action applies to one of the jobs, and the caller may do it.
 * @param {ActionName} name
 * @param {Job[]} jobs
 */
export function isPossible(name, jobs) {
  return jobs.some((job) => ACTIONS[name].applies(job) && session.mayChange(job));
}

/**
 * Does an action to the jobs it applies to, after asking where something is lost.
 * @param {ActionName} name
 * @param {Job[]} jobs
 * @param {Effects} effects
 */
export async function act(name, jobs, effects) {
  const chosen = jobs.filter((job) => ACTIONS[name].applies(job) && session.mayChange(job));
  if (chosen.length === 0) {
    toast(`${ACTIONS[name].label}: it applies to none of the chosen jobs.`, { kind: 'error' });
    return;
  }
  try {
    const work = await prepare(name, chosen, effects);
    if (work === null) return;
    await runAll(name, chosen, work, effects);
  } catch (error) {
    toastError(ACTIONS[name].label, error);
  }
}

/**
 * @param {ActionName} name
 * @param {Job[]} jobs
 * @param {Effects} effects
 * @returns {Promise<((job: Job) => Promise<Job | null>) | null>} What to do to each; null if the user has changed their mind.
 */
async function prepare(name, jobs, effects) {
  const path = (/** @type {Job} */ job) => `/v1/jobs/${job.id}`;
  switch (name) {
    case 'pause':
    case 'resume':
    case 'retry':
      return (job) => send('POST', `${path(job)}/${name}`);
    case 'cancel':
      return (await confirmCancel(jobs)) ? (job) => send('POST', `${path(job)}/cancel`) : null;
    case 'delete':
      return (await confirmDelete(jobs)) ? (job) => send('DELETE', path(job)) : null;
    case 'priority': {
      const priority = await askForPriority(jobs);
      return priority === null ? null : (job) => send('PATCH', path(job), { json: { priority } });
    }
    case 'first':
      return (job) => send('POST', `${path(job)}/move`, { json: { first: true } });
    case 'move': {
      const target = await askForPlace(jobs, effects.others?.() ?? []);
      return target === null ? null : (job) => send('POST', `${path(job)}/move`, { json: target });
    }
  }
}

/**
 * @param {ActionName} name
 * @param {Job[]} jobs
 * @param {(job: Job) => Promise<Job | null>} work
 * @param {Effects} effects
 */
async function runAll(name, jobs, work, effects) {
  const isMove = name === 'first' || name === 'move';
  // The last to move to the front is the first.
  const rest = isMove ? [...jobs].reverse() : [...jobs];
  /** @type {{job: Job, error: unknown}[]} */
  const failures = [];
  const runner = async () => {
    for (let job = rest.shift(); job !== undefined; job = rest.shift()) {
      try {
        const answer = await work(job);
        if (name === 'delete') effects.deleted(job.id);
        else effects.changed(answer !== null && typeof answer === 'object' && 'id' in answer ? answer : null);
      } catch (error) {
        const isGone = name === 'delete' && error instanceof Problem && error.status === 404;
        if (isGone) effects.deleted(job.id);
        else failures.push({ job, error });
      }
    }
  };
  await Promise.all(Array.from({ length: isMove ? 1 : AT_ONCE }, runner));
  const done = jobs.length - failures.length;
  if (done > 0) {
    const [only] = jobs;
    toast(`${ACTIONS[name].done} ${jobs.length === 1 && only ? only.name : counted(done, 'job')}`);
  }
  const [first] = failures;
  if (first) {
    const more = failures.length > 1 ? ` (and ${failures.length - 1} more)` : '';
    toast(`${ACTIONS[name].label}, ${first.job.name}${more}: ${messageOf(first.error)}`, { kind: 'error' });
  }
}

/** @param {Job[]} jobs */
function names(jobs) {
  const listed = jobs.length > LISTED + 1 ? jobs.slice(0, LISTED) : jobs;
  const items = listed.map((job) => h('li', {}, h('b', {}, job.name), h('span', { class: 'muted' }, isUnfinished(job) ? ` ${percent(job.progress)} rendered` : ` ${job.state}`)));
  if (listed.length < jobs.length) items.push(h('li', { class: 'muted' }, `and ${jobs.length - listed.length} more`));
  return h('ul', {}, ...items);
}

/** @param {Job[]} jobs */
function confirmCancel(jobs) {
  const rendered = jobs.filter((job) => job.progress > 0).length;
  return confirm({
    title: jobs.length === 1 ? `Cancel ${jobs[0]?.name}?` : `Cancel ${counted(jobs.length, 'job')}?`,
    body: [
      names(jobs),
      h('p', {}, rendered === 0 ? 'Nothing of it has been rendered.' : 'Finished pictures stay. What has been rendered of unfinished frames is lost, and a cancelled job cannot be continued: it can only be submitted again.'),
    ],
    action: jobs.length === 1 ? 'Cancel the job' : `Cancel ${counted(jobs.length, 'job')}`,
  });
}

/** @param {Job[]} jobs */
async function confirmDelete(jobs) {
  const lost = { pictures: 0, size_bytes: 0 };
  const rest = [...jobs];
  const runner = async () => {
    for (let job = rest.shift(); job !== undefined; job = rest.shift()) {
      const view = await getJson(`/v1/jobs/${job.id}`, { method: 'DELETE', query: { dry_run: true } });
      lost.pictures += view.pictures;
      lost.size_bytes += view.size_bytes;
    }
  };
  await Promise.all(Array.from({ length: AT_ONCE }, runner));
  const running = jobs.filter(isUnfinished).length;
  return confirm({
    title: jobs.length === 1 ? `Delete ${jobs[0]?.name}?` : `Delete ${counted(jobs.length, 'job')}?`,
    body: [
      names(jobs),
      h('p', {}, lossText(jobs.length, lost.pictures, lost.size_bytes)),
      ...(running > 0 ? [h('p', {}, running === 1 ? 'It is not finished: it is cancelled first.' : `${counted(running, 'job')} of them are not finished: they are cancelled first.`)] : []),
      h('p', {}, 'This cannot be undone.'),
    ],
    action: jobs.length === 1 ? 'Delete the job' : `Delete ${counted(jobs.length, 'job')}`,
  });
}

/**
 * Losses of a deletion.
 * @param {number} jobs
 * @param {number} pictures
 * @param {number} bytes
 */
function lossText(jobs, pictures, bytes) {
  // The server tells of each job alone, so pictures that only these jobs share are not in its number.
  const shared = jobs > 1 ? ' Pictures that only these jobs share are lost too.' : '';
  if (pictures === 0) return `No picture is lost: there is none, or other jobs use the same.${shared}`;
  return `${counted(pictures, 'picture')} (${size(bytes)}) that no other job uses will be lost.${shared}`;
}

/**
 * @param {Job[]} jobs
 * @returns {Promise<number | null>}
 */
async function askForPriority(jobs) {
  const input = h('input', { type: 'number', id: 'priority', min: -100, max: 100, step: 1, required: true, value: jobs[0]?.priority ?? 0 });
  const chosen = await showDialog({
    title: jobs.length === 1 ? `Priority of ${jobs[0]?.name}` : `Priority of ${counted(jobs.length, 'job')}`,
    body: [h('label', { for: 'priority' }, 'Priority, from −100 to 100'), input, h('p', { class: 'muted' }, 'Jobs of higher priority are rendered first, from any submitter. A key may have a highest priority of its own.')],
    actions: [{ label: 'Set', value: 'set', kind: 'primary' }],
    onOpen: () => input.select(),
  });
  return chosen === null ? null : Math.trunc(Number(input.value));
}

/**
 * @param {Job[]} jobs
 * @param {Job[]} all
 * @returns {Promise<{before: string} | {after: string} | {first: true} | null>}
 */
async function askForPlace(jobs, all) {
  const moved = new Set(jobs.map((job) => job.id));
  const others = all.filter((job) => isUnfinished(job) && !moved.has(job.id)).sort((a, b) => (a.queue_position ?? 1e9) - (b.queue_position ?? 1e9));
  const where = h('select', { id: 'where' }, h('option', { value: 'before' }, 'before'), h('option', { value: 'after' }, 'after'));
  const which = h('select', { id: 'which' }, ...others.map((job) => h('option', { value: job.id }, `${job.queue_position ? `${job.queue_position}. ` : ''}${job.name} (${job.submitter}, priority ${job.priority})`)));
  const chosen = await showDialog({
    title: jobs.length === 1 ? `Move ${jobs[0]?.name}` : `Move ${counted(jobs.length, 'job')}`,
    body:
      others.length === 0
        ? [h('p', {}, 'No other job is waiting.')]
        : [h('p', { class: 'muted' }, 'A moved job takes the priority of the job it is placed beside.'), h('div', { class: 'row' }, h('label', { class: 'visually-hidden', for: 'where' }, 'Side'), where, h('label', { class: 'visually-hidden', for: 'which' }, 'Job'), which)],
    actions: [...(others.length > 0 ? [/** @type {const} */ ({ label: 'Move', value: 'move', kind: 'primary' })] : [])],
    onOpen: () => where.focus(),
  });
  if (chosen === null) return null;
  return where.value === 'after' ? { after: which.value } : { before: which.value };
}
