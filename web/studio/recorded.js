// Renders of a draft that are based on its render before: the farm keeps the tiles of such jobs, and renders only those that
// an edit can change. The picture is the same.

import { Problem } from '/ui/api.js';
import { submit } from './server.js';

const WANTED = 'sdfarm.studio.recorded';
const JOB = 'sdfarm.studio.recorded.';

/** @param {string} name */
const read = (name) => {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
};

/**
 * @param {string} name
 * @param {string} value
 */
const write = (name, value) => {
  try {
    localStorage.setItem(name, value);
  } catch {
    // Without storage, the next visit renders everything.
  }
};

/** Whether renders are recorded. */
export const isWanted = () => read(WANTED) === 'yes';

/** @param {boolean} wanted */
export const want = (wanted) => write(WANTED, wanted ? 'yes' : 'no');

/**
 * Submits a draft's text, based on the draft's recorded job if there is one.
 * @param {string} draft
 * @param {string} text
 * @param {string} key
 */
export async function submitDraft(draft, text, key) {
  if (!isWanted()) return submit(text, key);
  const earlier = read(JOB + draft);
  const job = (earlier === null ? null : await submitBasedOn(earlier, text, `${key}-based`)) ?? (await submit(text, `${key}-recorded`, { record: true }));
  write(JOB + draft, job.id);
  return job;
}

/**
 * Submits an edit of a job; null if that job is gone.
 * @param {string} earlier
 * @param {string} text
 * @param {string} key
 */
async function submitBasedOn(earlier, text, key) {
  try {
    return await submit(text, key, { based_on: earlier });
  } catch (error) {
    if (error instanceof Problem && (error.code === 'unknown_job' || error.code === 'wrong_query')) return null;
    throw error;
  }
}
