// Farms for the tests: real servers, each with a folder of its own.

import { spawn, spawnSync } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

const DEADLINE_MS = 12_000;
const POLL_MS = 40;

/** The program under test. */
export const program = process.argv[2];

/** Environment without flags of the program. */
export const environment = Object.fromEntries(Object.entries(process.env).filter(([name]) => !name.startsWith('SDFARM_')));

/** Waits until a function returns something true; what it last returned or threw is in the error. */
export async function until(what, check, deadline = DEADLINE_MS) {
  const end = Date.now() + deadline;
  for (;;) {
    let last;
    try {
      last = await check();
      if (last) return last;
    } catch (error) {
      last = error;
    }
    if (Date.now() > end) throw new Error(`${what} did not happen: ${last}`);
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
}

/** A port that is free now. */
export function freePort() {
  return new Promise((resolve, reject) => {
    const server = createServer();
    server.once('error', reject);
    server.listen(0, '127.0.0.1', () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });
}

/** A job that takes a few milliseconds. */
export function smallJob(name = 'small', change = {}) {
  return {
    name,
    image: { width: 64, height: 40, samples: 1, ...change.image },
    scene: {
      camera: { position: [0, 1, 4], look_at: [0, 0, 0] },
      lights: [{ directional: { direction: [1, 2, 1] } }],
      materials: { clay: { diffuse: { kd: '#d9472b' } } },
      objects: [{ material: 'clay', shape: { sphere: { radius: 1 } } }],
      ...change.scene,
    },
    ...(change.frames ? { frames: change.frames } : {}),
  };
}

/** Farms that run now. */
const running = new Set();
process.on('exit', () => running.forEach((farm) => farm.kill()));

export class Farm {
  constructor() {
    this.folder = mkdtempSync(join(tmpdir(), 'sdfarm-page-'));
    this.key = null;
  }

  /** Starts a farm with these `flags` of `serve`. */
  static async start(flags = []) {
    const farm = new Farm();
    farm.port = await freePort();
    farm.flags = flags;
    await farm.serve();
    return farm;
  }

  get address() {
    return `http://127.0.0.1:${this.port}`;
  }

  /** Starts the server, again on the same port and folder after a kill. */
  async serve() {
    const workers = this.flags.includes('--workers') ? [] : ['--workers', '1'];
    const child = spawn(program, ['serve', '--listen', `127.0.0.1:${this.port}`, '--data', join(this.folder, 'data'), ...workers, ...this.flags], { env: environment, stdio: ['ignore', 'pipe', 'pipe'], detached: true });
    this.child = child;
    this.log = '';
    child.stderr.on('data', (bytes) => (this.log = (this.log + bytes).slice(-8000)));
    child.stdout.on('data', () => {});
    running.add(this);
    await until('a farm that answers', async () => {
      if (child.exitCode !== null) throw new Error(`the server has ended: ${this.log}`);
      return (await fetch(`${this.address}/livez`)).ok;
    });
  }

  /** Kills the server as a power cut would. */
  kill() {
    running.delete(this);
    try {
      process.kill(-this.child.pid, 'SIGKILL');
    } catch {
      // It has ended.
    }
  }

  /** Ends the farm, and removes its folder. */
  stop() {
    this.kill();
    rmSync(this.folder, { recursive: true, force: true, maxRetries: 5 });
  }

  /** Runs a command of the program on the farm's folder. */
  command(...words) {
    const done = spawnSync(program, [...words, '--data', join(this.folder, 'data')], { env: environment, encoding: 'utf8' });
    if (done.status !== 0) throw new Error(`${words.join(' ')}: ${done.stderr}`);
    return done.stdout;
  }

  /** Creates a key; the first must be an administrator's. */
  newKey(name, ...scopes) {
    const secret = /sdf_\S+/.exec(this.command('key', 'new', name, '--rate', '100000', ...scopes.flatMap((scope) => ['--scope', scope])))?.[0];
    if (!secret) throw new Error('no secret was printed');
    return secret;
  }

  /** Requests a path; throws for every answer but a success. */
  async send(method, path, body, key = this.key) {
    const response = await fetch(this.address + path, {
      method,
      headers: { 'content-type': 'application/json', ...(key ? { authorization: `Bearer ${key}` } : {}) },
      ...(body === undefined ? {} : { body: typeof body === 'string' ? body : JSON.stringify(body) }),
    });
    const text = await response.text();
    if (!response.ok) throw new Error(`${method} ${path}: ${response.status} ${text}`);
    return text === '' ? null : JSON.parse(text);
  }

  get(path) {
    return this.send('GET', path);
  }

  submit(job, key = this.key) {
    return this.send('POST', '/v1/jobs', job, key);
  }

  /** Submits a job and waits for its end. */
  async render(job) {
    const { id } = await this.submit(job);
    return until(`the end of ${job.name}`, async () => {
      const now = await this.get(`/v1/jobs/${id}`);
      return ['succeeded', 'failed'].includes(now.state) && now;
    });
  }

  /** Whether the server has a route. */
  async has(method, path) {
    this.document ??= await this.get('/openapi.json');
    return this.document.paths[path]?.[method.toLowerCase()] !== undefined;
  }
}
