// Approximate pictures by WebGPU: runs the program of `POST /v1/shader` and shows its picture in a canvas.
// It knows no scene: docs/page.md, "Approximate pictures", describes how the program is bound.

/** Edge of a workgroup, in pixels. */
const GROUP = 8;
/** A tile of a picture should take this long, in milliseconds. */
const TILE_MS = 40;
/** Pixels of the first tile of a picture, and how many times larger the next may be: no work of unknown length is submitted. */
const FIRST_TILE_PIXELS = 256;
const MOST_GROWTH = 16;
/** Bytes of the block that says what a dispatch renders. */
const DISPATCH_BYTES = 32;

/** Copies the picture to the canvas: nearest pixels, premultiplied. */
const SHOW = `
@group(0) @binding(0) var<storage, read> picture: array<u32>;
@group(0) @binding(1) var<uniform> size: vec4<u32>;
@vertex fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn color(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let at = min(vec2<u32>(place.xy * vec2<f32>(size.xy) / vec2<f32>(size.zw)), size.xy - 1u);
    let pixel = unpack4x8unorm(picture[at.y * size.x + at.x]);
    return vec4<f32>(pixel.rgb * pixel.a, pixel.a);
}`;

/**
 * @typedef {object} RendererOptions
 * @property {HTMLCanvasElement | OffscreenCanvas | null} [canvas] Shows each band when it is rendered; null: pixels are only read.
 * @property {(reason: string) => void} [onLost] Called once if the GPU is lost: make a new renderer, or show previews.
 * @property {Limits} [limits] None by default.
 */

/**
 * Times in milliseconds after which a program, or a picture, is given up with an error. If the GPU does not answer by then,
 * the renderer is destroyed.
 * @typedef {{compileMs: number, drawMs: number}} Limits
 */
const NO_LIMITS = { compileMs: Infinity, drawMs: Infinity };

/**
 * @typedef {object} DrawOptions
 * @property {number} [samples] Number of samples a pixel; 1 by default.
 * @property {(share: number) => void} [onProgress] Called after each band with the share that is rendered, 0 to 1.
 */

/**
 * Makes a renderer; null where there is no WebGPU (no secure context, an old browser, no adapter).
 * @param {RendererOptions} [options]
 * @returns {Promise<Renderer | null>}
 */
export async function createRenderer({ canvas = null, onLost = () => {}, limits = NO_LIMITS } = {}) {
  // Where there is no WebGPU, the types are wrong to promise it.
  const gpu = /** @type {GPU | undefined} */ (navigator.gpu);
  if (!gpu) return null;
  let device;
  try {
    const adapter = await gpu.requestAdapter({ powerPreference: 'high-performance' });
    if (!adapter) return null;
    const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
    device = await adapter.requestDevice({ requiredLimits: { maxStorageBufferBindingSize, maxBufferSize } });
  } catch {
    return null;
  }
  const context = canvas ? /** @type {GPUCanvasContext | null} */ (canvas.getContext('webgpu')) : null;
  if (canvas && !context) {
    device.destroy();
    return null;
  }
  return new Renderer(device, { canvas, context, format: gpu.getPreferredCanvasFormat(), onLost, limits });
}

const COMPILE = 'compile the program of this scene';
const DRAW = 'draw this scene';
/** @param {string} what */
const tooLong = (what) => `this machine’s GPU takes too long to ${what}`;

/**
 * A number of pixels, as whole workgroups.
 * @param {number} pixels
 */
const whole = (pixels) => Math.floor(pixels / GROUP) * GROUP;

/** Renders the pictures of one program at a time. */
export class Renderer {
  #device;
  #canvas;
  #context;
  #format;
  #layout;
  /** @type {GPUComputePipeline | null} */
  #pipeline = null;
  /** @type {GPURenderPipeline | null} */
  #show = null;
  /** @type {GPUBuffer} */
  #dispatch;
  /** @type {GPUBuffer} */
  #size;
  /** @type {GPUBuffer} */
  #numbers;
  /** @type {GPUBuffer} */
  #words;
  /** @type {{sums: GPUBuffer, picture: GPUBuffer} | null} What the size decides. */
  #target = null;
  /** @type {GPUBindGroup | null} */
  #bindings = null;
  /** @type {GPUBindGroup | null} */
  #showBindings = null;
  #width = 0; #height = 0;
  /** Raised by each draw and change: what began under a lower one stops. */
  #turn = 0;
  #programTurn = 0;
  #isLost = false;
  #limits;
  /** Whether the program has been dispatched: some devices compile it then. */
  #isCompiled = false;

  /**
   * @param {GPUDevice} device
   * @param {Required<RendererOptions> & {context: GPUCanvasContext | null, format: GPUTextureFormat}} options
   */
  constructor(device, { canvas, context, format, onLost, limits }) {
    this.#device = device;
    this.#limits = limits;
    this.#canvas = canvas;
    this.#context = context;
    this.#format = format;
    /** @type {(binding: number, type: GPUBufferBindingType) => GPUBindGroupLayoutEntry} */
    const buffer = (binding, type) => ({ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } });
    this.#layout = device.createBindGroupLayout({
      entries: [buffer(0, 'uniform'), buffer(1, 'read-only-storage'), buffer(2, 'read-only-storage'), buffer(3, 'storage'), buffer(4, 'storage')],
    });
    const uniform = (/** @type {number} */ size) => device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.#dispatch = uniform(DISPATCH_BYTES);
    this.#size = uniform(16);
    this.#numbers = this.#storage(4);
    this.#words = this.#storage(4);
    void device.lost.then(({ reason, message }) => {
      this.#isLost = true;
      this.#turn += 1;
      if (reason !== 'destroyed') onLost(message || 'the GPU was lost');
    });
  }

  /** Whether the GPU was lost, or the renderer destroyed. */
  get isLost() {
    return this.#isLost;
  }

  /**
   * Compiles a program. Rejects with the compiler's messages if it is invalid, and if it takes too long; resolves to false
   * if a later program replaced it in the meantime.
   * @param {string} wgsl
   * @returns {Promise<boolean>}
   */
  async setProgram(wgsl) {
    this.#turn += 1;
    this.#programTurn += 1;
    const turn = this.#programTurn;
    const module = this.#device.createShaderModule({ code: wgsl });
    const layout = this.#device.createPipelineLayout({ bindGroupLayouts: [this.#layout] });
    let pipeline;
    const compiling = this.#device.createComputePipelineAsync({ layout, compute: { module, entryPoint: 'render' } });
    try {
      pipeline = await this.#answer(compiling, this.#limits.compileMs, COMPILE);
    } catch (error) {
      if (this.#isLost) throw error;
      const { messages } = await module.getCompilationInfo();
      const errors = messages.filter(({ type }) => type === 'error');
      const texts = errors.map(({ lineNum, message }) => `line ${lineNum}: ${message}`);
      throw new Error(`the program does not compile: ${texts.join('; ') || error}`);
    }
    if (turn !== this.#programTurn) return false;
    this.#pipeline = pipeline;
    this.#isCompiled = false;
    return true;
  }

  /**
   * Sets the size of the picture in pixels, and that of the canvas.
   * @param {number} width
   * @param {number} height
   */
  setSize(width, height) {
    if (width === this.#width && height === this.#height) return;
    this.#turn += 1;
    this.#target?.sums.destroy();
    this.#target?.picture.destroy();
    this.#width = width;
    this.#height = height;
    if (this.#canvas) {
      this.#canvas.width = width;
      this.#canvas.height = height;
    }
    this.#target = { sums: this.#storage(16 * width * height), picture: this.#storage(4 * width * height) };
    this.#bindings = null;
    this.#showBindings = null;
  }

  /**
   * Sets the inputs of the program: `uniforms` and `table` of `POST /v1/shader`.
   * @param {ArrayLike<number>} uniforms
   * @param {ArrayLike<number>} table
   */
  setNumbers(uniforms, table) {
    this.#turn += 1;
    this.#numbers = this.#filled(this.#numbers, uniforms);
    this.#words = this.#filled(this.#words, table);
  }

  /**
   * Renders the picture in bands, each in tiles. Resolves to false if a later draw or change replaced it, or the GPU was
   * lost; rejects if it takes too long.
   * @param {DrawOptions} [options]
   * @returns {Promise<boolean>}
   */
  async draw({ samples = 1, onProgress = () => {} } = {}) {
    const [pipeline, target] = [this.#pipeline, this.#target];
    if (!pipeline || !target) throw new Error('set a program, its numbers and a size before drawing');
    this.#turn += 1;
    const turn = this.#turn;
    const [width, height] = [this.#width, this.#height];
    const isCurrent = () => !this.#isLost && turn === this.#turn;
    await this.#compile(pipeline, target);
    const begin = performance.now();
    let pixels = FIRST_TILE_PIXELS;
    for (let sample = 0; sample < samples; sample += 1) {
      for (let y = 0; y < height; ) {
        const rows = Math.min(height - y, Math.max(GROUP, whole(pixels / width)));
        for (let x = 0; x < width; ) {
          if (!isCurrent()) return false;
          const columns = Math.min(width - x, Math.max(GROUP, whole(pixels / rows)));
          const start = performance.now();
          this.#render(pipeline, target, { x, y, columns, rows, sample });
          x += columns;
          if (x >= width) this.#present(target);
          await this.#answer(this.#device.queue.onSubmittedWorkDone(), this.#limits.drawMs, DRAW);
          if (performance.now() - begin > this.#limits.drawMs) throw new Error(tooLong(DRAW));
          pixels = Math.min(MOST_GROWTH * pixels, (columns * rows * TILE_MS) / Math.max(0.5, performance.now() - start));
        }
        y += rows;
        onProgress((sample + y / height) / samples);
      }
    }
    return isCurrent();
  }

  /**
   * Reads the picture: RGBA of 8 bits, row by row, with straight alpha.
   * @returns {Promise<{width: number, height: number, data: Uint8ClampedArray}>}
   */
  async readPixels() {
    if (!this.#target) throw new Error('set a size before reading');
    const [width, height] = [this.#width, this.#height];
    const size = 4 * width * height;
    const copy = this.#device.createBuffer({ size, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = this.#device.createCommandEncoder();
    encoder.copyBufferToBuffer(this.#target.picture, 0, copy, 0, size);
    this.#device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const data = new Uint8ClampedArray(copy.getMappedRange().slice(0));
    copy.destroy();
    return { width, height, data };
  }

  /** Frees the GPU's memory. */
  destroy() {
    this.#turn += 1;
    this.#isLost = true;
    this.#device.destroy();
  }

  /**
   * Waits for the GPU. One that takes too long is left, with what it still does.
   * @template T
   * @param {Promise<T>} work
   * @param {number} limitMs
   * @param {string} what that takes too long
   * @returns {Promise<T>}
   */
  async #answer(work, limitMs, what) {
    if (limitMs === Infinity) return work;
    let timer = 0;
    /** @type {Promise<never>} */
    const late = new Promise((_, reject) => {
      timer = setTimeout(() => {
        reject(new Error(tooLong(what)));
        this.destroy();
      }, limitMs);
    });
    try {
      return await Promise.race([work, late]);
    } finally {
      clearTimeout(timer);
    }
  }

  /**
   * Dispatches a program for the first time, for no pixel.
   * @param {GPUComputePipeline} pipeline
   * @param {{sums: GPUBuffer, picture: GPUBuffer}} target
   */
  async #compile(pipeline, target) {
    if (this.#isCompiled) return;
    this.#render(pipeline, target, { x: 0, y: 0, columns: 0, rows: 0, sample: 0 });
    await this.#answer(this.#device.queue.onSubmittedWorkDone(), this.#limits.compileMs, COMPILE);
    if (pipeline === this.#pipeline) this.#isCompiled = true;
  }

  /** @param {number} size in bytes */
  #storage(size) {
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;
    return this.#device.createBuffer({ size, usage });
  }

  /**
   * The buffer with these words; a new one if their number has changed.
   * @param {GPUBuffer} buffer
   * @param {ArrayLike<number>} values
   */
  #filled(buffer, values) {
    const words = values.length > 0 ? Uint32Array.from(values) : new Uint32Array(1);
    let filled = buffer;
    if (buffer.size !== words.byteLength) {
      buffer.destroy();
      filled = this.#storage(words.byteLength);
      this.#bindings = null;
    }
    this.#device.queue.writeBuffer(filled, 0, words);
    return filled;
  }

  /**
   * Renders a tile of one sample.
   * @param {GPUComputePipeline} pipeline
   * @param {{sums: GPUBuffer, picture: GPUBuffer}} target
   * @param {{x: number, y: number, columns: number, rows: number, sample: number}} tile
   */
  #render(pipeline, { sums, picture }, { x, y, columns, rows, sample }) {
    const buffers = [this.#dispatch, this.#numbers, this.#words, sums, picture];
    this.#bindings ??= this.#device.createBindGroup({
      layout: this.#layout,
      entries: buffers.map((buffer, binding) => ({ binding, resource: { buffer } })),
    });
    const block = new Uint32Array([x, y, columns, rows, this.#width, sample, sample + 1, 0]);
    this.#device.queue.writeBuffer(this.#dispatch, 0, block);
    const encoder = this.#device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, this.#bindings);
    pass.dispatchWorkgroups(Math.max(1, Math.ceil(columns / GROUP)), Math.max(1, Math.ceil(rows / GROUP)));
    pass.end();
    this.#device.queue.submit([encoder.finish()]);
  }

  /**
   * Copies the picture so far to the canvas.
   * @param {{picture: GPUBuffer}} target
   */
  #present({ picture }) {
    if (!this.#context || !this.#canvas) return;
    if (!this.#show) {
      this.#context.configure({ device: this.#device, format: this.#format, alphaMode: 'premultiplied' });
      const module = this.#device.createShaderModule({ code: SHOW });
      this.#show = this.#device.createRenderPipeline({
        layout: 'auto',
        vertex: { module, entryPoint: 'corner' },
        fragment: { module, entryPoint: 'color', targets: [{ format: this.#format }] },
      });
    }
    this.#showBindings ??= this.#device.createBindGroup({
      layout: this.#show.getBindGroupLayout(0),
      entries: [
        { binding: 0, resource: { buffer: picture } },
        { binding: 1, resource: { buffer: this.#size } },
      ],
    });
    const { width, height } = this.#canvas;
    this.#device.queue.writeBuffer(this.#size, 0, new Uint32Array([this.#width, this.#height, width, height]));
    const encoder = this.#device.createCommandEncoder();
    const view = this.#context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view, loadOp: 'clear', storeOp: 'store', clearValue: [0, 0, 0, 0] }],
    });
    pass.setPipeline(this.#show);
    pass.setBindGroup(0, this.#showBindings);
    pass.draw(3);
    pass.end();
    this.#device.queue.submit([encoder.finish()]);
  }
}
