// The room Farm: what needs somebody, workers, queue, history, disk, keys and the audit log.

import { getJson, messageOf, readCaller, send } from '/ui/api.js';
import { farmEvents } from '/ui/events.js';
import { append, h, setText } from '/ui/parts/dom.js';
import { confirm } from '/ui/parts/dialog.js';
import { icon } from '/ui/parts/icons.js';
import { Room, emptyState, heading } from '/ui/parts/room.js';
import { addShortcuts } from '/ui/parts/shortcuts.js';
import { toastError } from '/ui/parts/toast.js';
import { Alerts, Disk } from '/ui/rooms/farm/alerts.js';
import { Audit } from '/ui/rooms/farm/audit.js';
import { Charts } from '/ui/rooms/farm/charts.js';
import { Keys } from '/ui/rooms/farm/keys.js';
import { Queue } from '/ui/rooms/farm/queue.js';
import { Workers } from '/ui/rooms/farm/workers.js';
import { session } from '/ui/session.js';

/** Time after which workers and alerts are read again. */
const OFTEN_MS = 5000;
/** Time after which history, disk and log are read again. */
const SELDOM_MS = 30_000;

class FarmRoom extends Room {
  isPaused = false;
  #reading = false;

  enter() {
    this.setTitle('Farm');
    this.state = h('span', { class: 'state' });
    this.pause = h('button', { type: 'button', class: 'button', hidden: true, on: { click: () => void this.#togglePause() } });
    append(this, [h('div', { class: 'room-head' }, heading('Farm'), this.state, h('span', { class: 'grow' }), this.pause)]);
    if (!session.mayRead) {
      append(this, [emptyState('Your key does not show the farm', h('p', {}, 'It takes the scope read or admin. Your own jobs are in the room Jobs.'), h('a', { class: 'button', href: '#/jobs' }, 'Jobs'))]);
      return;
    }
    const { signal } = this;
    this.alerts = new Alerts(signal);
    this.workers = new Workers(signal);
    this.queue = new Queue(signal);
    this.charts = new Charts(signal);
    this.disk = new Disk(signal);
    this.keys = session.mayAudit ? new Keys(signal) : null;
    this.audit = session.mayAudit ? new Audit(signal) : null;
    append(this, [
      this.alerts.element,
      this.charts.element,
      this.workers.element,
      h('div', { class: 'farm-columns' }, this.queue.element, this.disk.element),
      this.keys?.element,
      this.audit?.element,
      session.isReadOnly ? h('p', { class: 'muted' }, 'This page is read-only: the server refuses changes from browsers.') : null,
    ]);
    this.listen(farmEvents, 'farm', (event) => this.#showPaused(event.detail.paused));
    this.listen(farmEvents, 'open', () => this.#readAll());
    this.listen(document, 'keychange', () => void this.#keyChanged());
    this.every(OFTEN_MS, () => void this.#readOften());
    this.every(SELDOM_MS, () => void this.#readSeldom());
    addShortcuts(
      session.mayAdminister
        ? [
            { keys: '+', text: 'One more worker on the server’s machine', group: 'Farm', run: () => void this.workers?.resize(1) },
            { keys: '-', text: 'One worker fewer on the server’s machine', group: 'Farm', run: () => void this.workers?.resize(-1) },
            { keys: 'p', text: 'Pause or resume the farm', group: 'Farm', run: () => void this.#togglePause() },
          ]
        : [],
      signal,
    );
    this.#readAll();
  }

  #readAll() {
    void this.#readOften();
    void this.#readSeldom();
    void this.queue?.read();
    void this.keys?.read();
  }

  async #readOften() {
    if (this.#reading) return;
    this.#reading = true;
    await Promise.all([this.workers?.read(), this.alerts?.read()]);
    this.#reading = false;
  }

  async #readSeldom() {
    void this.charts?.read();
    void this.audit?.read();
    try {
      const farm = await getJson('/v1/farm', { signal: this.signal });
      this.#showPaused(farm.paused);
      this.disk?.show(farm.disk);
    } catch (error) {
      if (!this.signal.aborted && this.state) setText(this.state, messageOf(error));
    }
  }

  /** @param {boolean} isPaused */
  #showPaused(isPaused) {
    const { state, pause } = this;
    if (!state || !pause) return;
    this.isPaused = isPaused;
    state.className = `state ${isPaused ? 'paused' : 'succeeded'}`;
    setText(state, isPaused ? 'paused: no tile is leased' : 'open');
    pause.hidden = !session.mayAdminister;
    pause.className = isPaused ? 'button primary' : 'button';
    pause.replaceChildren(icon(isPaused ? 'play' : 'pause'), isPaused ? 'Resume the farm' : 'Pause the farm');
  }

  async #togglePause() {
    const wasPaused = this.isPaused;
    if (!wasPaused && !(await confirm({ title: 'Pause the farm?', body: [h('p', {}, 'No tile is leased until it is resumed. Leased tiles finish and count; jobs can still be submitted.')], action: 'Pause the farm', isDanger: false }))) return;
    try {
      const farm = await send('POST', `/v1/farm/${wasPaused ? 'resume' : 'pause'}`);
      this.#showPaused(farm.paused);
    } catch (error) {
      toastError(wasPaused ? 'The farm could not be resumed' : 'The farm could not be paused', error);
    }
    void this.alerts?.read();
  }

  async #keyChanged() {
    try {
      await readCaller(this.signal);
      farmEvents.start();
    } catch (error) {
      toastError('The new key', error);
    }
  }
}

customElements.define('room-farm', FarmRoom);
