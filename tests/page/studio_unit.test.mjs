// Tests the studio's modules that need no browser: `node --test tests/page/`.
import assert from 'node:assert/strict';
import { readFileSync, readdirSync } from 'node:fs';
import { test } from 'node:test';
import { dot, dolly, digits, length, look, lookAtPoint, move, orbit, pan, readCamera, subtract, unit, writeCamera, axes, isInGroup } from '../../web/studio/camera.js';
import { colorOf, decode, encode, hexOf, linearOf, parseText, writtenLike } from '../../web/studio/color.js';
import { objectOf, shownOf } from '../../web/studio/document.js';
import { applied, compact, insertEntry, removeAt, setMember, setNumbers, setPath, written } from '../../web/studio/edits.js';
import { insertExample, pretty } from '../../web/studio/insert.js';
import { find, nodeAt, parse, pathOf, pathOfPointer, placeAt, pointer, valueOf } from '../../web/studio/json.js';
import { NodeTable } from '../../web/studio/nodes.js';
import { dragged, slider, stepped } from '../../web/studio/numbers.js';
import { markOf, positionOf } from '../../web/studio/places.js';
import { sharper, stages } from '../../web/studio/stages.js';

const root = new URL('../../', import.meta.url);
const scenes = ['scenes/', 'docs/scenes/', 'docs/scenes/light/', 'docs/tutorial/'].flatMap((folder) =>
  readdirSync(new URL(folder, root)).filter((name) => name.endsWith('.json')).map((name) => readFileSync(new URL(folder + name, root), 'utf8')),
);
const csg = readFileSync(new URL('scenes/csg.json', root), 'utf8');

/** A generator that gives the same numbers in every run. */
function random(seed) {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1_664_525) + 1_013_904_223) >>> 0;
    return state / 2 ** 32;
  };
}

test('a text is read as JSON.parse reads it', () => {
  let compared = 0;
  for (const text of scenes) {
    let value;
    try {
      value = JSON.parse(text);
    } catch {
      continue;
    }
    assert.deepEqual(valueOf(parse(text)), value);
    compared += 1;
  }
  assert.ok(compared >= 30, `${compared} scenes`);
  assert.deepEqual(valueOf(parse('{ // c\n "a": [1, /* x */ 2.5e3,], "é\\u0041": "\\n", "b": null, }')), { a: [1, 2500], éA: '\n', b: null });
});

test('every position of every text leads to a node that contains it, and its pointer back to it', () => {
  const tree = parse(csg);
  for (let at = 0; at < csg.length; at += 1) {
    const node = nodeAt(tree, at);
    assert.ok(at >= (node.keyFrom < 0 ? node.from : Math.min(node.from, node.keyFrom)) && at <= node.to);
    const path = pathOfPointer(pointer(pathOf(node)));
    assert.equal(find(tree, path), node);
  }
  assert.equal(pointer(['a/b', 'c~d', 0]), '/a~1b/c~0d/0');
});

test('text that is cut, or has any character replaced, is read without an error', () => {
  const next = random(7);
  for (let round = 0; round < 600; round += 1) {
    const at = Math.floor(next() * csg.length);
    const junk = '{}[]":,/*\\\n1a'.charAt(Math.floor(next() * 13));
    for (const text of [csg.slice(0, at), csg.slice(0, at) + junk + csg.slice(at + 1), csg.slice(at)]) {
      const tree = parse(text);
      nodeAt(tree, at);
      placeAt(tree, at);
    }
  }
});

test('text that is deeper than any job is read to its end', () => {
  for (const piece of ['[', '{', '{"scene":', '[{"a":[', '{"a" {', '{]', '[}', '{:', '[1,{,']) {
    for (const depth of [511, 512, 513, 20_000]) {
      const text = piece.repeat(depth);
      const tree = parse(text);
      nodeAt(tree, text.length);
      placeAt(tree, text.length);
    }
  }
});

test('a place is a key or a value', () => {
  const place = (marked) => {
    const at = marked.indexOf('|');
    const text = marked.replace('|', '');
    const found = placeAt(parse(text), at);
    return found && [found.part, found.key, pointer(pathOf(found.node)), text.slice(found.from, found.to)];
  };
  assert.deepEqual(place('{ | }'), ['key', '', '', '']);
  assert.deepEqual(place('{ "ra|d" }'), ['key', 'rad', '', '"rad"']);
  assert.deepEqual(place('{ "a": 1, r| }'), ['key', 'r', '', 'r']);
  assert.deepEqual(place('{ "a": | }'), ['value', 'a', '/a', '']);
  assert.deepEqual(place('{ "a": "cl|', ), ['value', 'a', '/a', '"cl']);
  assert.deepEqual(place('{ "a": { "b": [1, |] } }'), ['value', '', '/a/b', '']);
  assert.deepEqual(place('{ "a": { "b": [1, 2|] } }'), ['value', '1', '/a/b/1', '2']);
  assert.deepEqual(place('{ "a": {} }|'), null);
});

test('edits change the least text', () => {
  const text = '{\n  "a": [1, 2, 3], // keep\n  "b": {}\n}\n';
  const tree = parse(text);
  assert.equal(applied(text, setNumbers(find(tree, ['a']), [1, 2.5, 3])), text.replace('2,', '2.5,'));
  assert.equal(applied(text, setMember(text, tree, 'c', '7')), '{\n  "a": [1, 2, 3], // keep\n  "b": {},\n  "c": 7\n}\n');
  assert.equal(applied(text, setMember(text, find(tree, ['b']), 'd', '[]')), text.replace('{}', '{ "d": [] }'));
  assert.equal(applied('[]', insertEntry('[]', parse('[]'), '1')), '[1]');
  assert.equal(applied('[1, ]', insertEntry('[1, ]', parse('[1, ]'), '2')), '[1, 2 ]');
  assert.equal(applied('{ "a": 1 }', setMember('{ "a": 1 }', parse('{ "a": 1 }'), 'a', '2')), '{ "a": 2 }');
  assert.deepEqual(JSON.parse(applied('{ "a": { "x": 1 } }', setPath('{ "a": { "x": 1 } }', parse('{ "a": { "x": 1 } }'), ['a', 'b', 'c'], '2'))), { a: { x: 1, b: { c: 2 } } });
  assert.equal(applied(text, setPath(text, tree, ['a', 1], '9')), text.replace('2,', '9,'));
  assert.deepEqual(setPath(text, tree, ['a', 'b'], '9'), []);
  for (const [before, path, after] of [['{ "a": 1, "b": 2 }', ['a'], '{ "b": 2 }'], ['{ "a": 1, "b": 2 }', ['b'], '{ "a": 1 }'], ['[1]', [0], '[]'], ['[1]', [4], '[1]']]) {
    assert.equal(applied(before, removeAt(parse(before), path)), after);
  }
  assert.deepEqual([written(0.1 + 0.2), written(-0.00001), written(1e-7), written(12, 0), written(-0)], ['0.3', '-0.00001', '1e-7', '12', '0']);
  assert.equal(compact({ a: [1, 'x'], b: {} }), '{ "a": [1, "x"], "b": {} }');
});

test('numbers keep their range, and few digits', () => {
  assert.equal(dragged(1.2, 10, 1, {}), '1.3');
  assert.equal(dragged(1.2, 10, 0.1, {}), '1.21');
  assert.equal(dragged(1.2, 10, 10, {}), '2.2');
  assert.equal(dragged(1.234, 0, 1, {}), '1.23');
  assert.equal(dragged(0.5, -1000, 1, { minimum: 1e-6 }), '0.000001');
  assert.equal(dragged(16, 13, 1, { isWhole: true, minimum: 1, maximum: 64 }), '18');
  assert.equal(dragged(16, 1e6, 1, { isWhole: true, minimum: 1, maximum: 64 }), '64');
  assert.equal(dragged(0, 5, 1, {}), '0.005');
  assert.equal(stepped(0.5, 1, 1, {}), '0.51');
  assert.equal(stepped(58.1, 1, 1, {}), '59.1');
  assert.equal(stepped(4, -1, 10, { isWhole: true, minimum: 1 }), '1');
  assert.deepEqual(slider(5, { minimum: 1, maximum: 64, isWhole: true }), { low: 1, high: 64, step: 1 });
  const wide = slider(5, { minimum: -1e6, maximum: 1e6 });
  assert.ok(wide.low < 5 && wide.high > 5 && wide.high - wide.low < 50);
});

test('colors go to the screen and back', () => {
  for (let byte = 0; byte < 256; byte += 1) {
    const hex = `#${byte.toString(16).padStart(2, '0').repeat(3)}`;
    assert.equal(hexOf(linearOf(hex)).hex, hex);
    assert.ok(Math.abs(encode(decode(byte / 255)) - byte / 255) < 1e-12);
  }
  assert.ok(Math.abs(linearOf('#808080')[0] - 0.215_861) < 1e-6);
  assert.deepEqual(parseText('#f00'), [1, 0, 0]);
  assert.deepEqual(parseText('rgb(255, 0, 100%)'), [1, 0, 1]);
  assert.equal(parseText('red'), undefined);
  assert.deepEqual(hexOf([4, 2, 0]), { hex: '#ffbc00', strength: 4 });
  const list = find(parse('{"c": [4, 2, 0]}'), ['c']);
  assert.equal(writtenLike('#ff0000', list), '[4, 0, 0]');
  assert.equal(writtenLike('#ff8800', find(parse('{"c": "#123456"}'), ['c'])), '"#ff8800"');
  assert.equal(colorOf(find(parse('{"c": {"kelvin": 6600}}'), ['c'])).isEditable, false);
  assert.equal(colorOf(find(parse('{"c": [1, 2]}'), ['c'])), undefined);
});

const view = { position: [1, 2, 5], lookAt: [0, 1, 0], up: [0, 1, 0], fov: 40, height: null, turn: 0 };
const distance = (each) => length(subtract(each.position, each.lookAt));

test('an orbit keeps the distance, and stops at the poles', () => {
  const next = random(3);
  let each = view;
  for (let step = 0; step < 2000; step += 1) {
    each = orbit(each, (next() - 0.5) * 2, (next() - 0.5) * 2);
    assert.ok(Math.abs(distance(each) - distance(view)) < 1e-9 * distance(view) * 2000);
    assert.ok(Math.abs(dot(unit(subtract(each.lookAt, each.position)), each.up)) < 0.999_95);
  }
  assert.ok(orbit(view, 0, 0.3).position[1] > view.position[1], 'a positive pitch lifts the camera');
  const quarter = orbit({ ...view, position: [0, 1, 5] }, Math.PI / 2, 0).position;
  assert.ok(Math.hypot(quarter[0] - 5, quarter[1] - 1, quarter[2]) < 1e-9, 'counter-clockwise from above');
});

test('pan, dolly, look and fly do what they say', () => {
  const { right, up, forward } = axes(view);
  for (const [a, b] of [[right, up], [right, forward], [up, forward]]) assert.ok(Math.abs(dot(a, b)) < 1e-12);
  const panned = pan(view, 0.5, 0);
  assert.ok(Math.abs(distance(panned) - distance(view)) < 1e-12);
  const shift = subtract(panned.position, view.position);
  assert.ok(Math.abs(dot(shift, right) - 0.5 * 2 * distance(view) * Math.tan((20 * Math.PI) / 180)) < 1e-9, 'half of what is seen');
  assert.ok(Math.abs(distance(dolly(view, 0.5)) - distance(view) / 2) < 1e-12);
  assert.equal(dolly({ ...view, height: 4 }, 0.5).height, 2);
  assert.deepEqual(dolly({ ...view, height: 4 }, 0.5).position, view.position);
  assert.deepEqual(look(view, 0.4, 0.2).position, view.position);
  assert.ok(dot(subtract(look(view, 0.2, 0).lookAt, view.lookAt), right) < 0, 'a positive yaw looks to the left');
  const flown = move(view, 0, 0, 2);
  assert.ok(length(subtract(subtract(flown.position, view.position), forward.map((part) => part * 2))) < 1e-12);
  assert.deepEqual(lookAtPoint(view, [3, 3, 3]).lookAt, [3, 3, 3]);
  assert.deepEqual(lookAtPoint(view, view.position), view);
  assert.ok(digits({ ...view, lookAt: [1, 2, 4.99] }) > digits(view));
});

test('the camera of a text is read and written, and refused with a reason', () => {
  const tree = parse(csg);
  const read = readCamera(tree, 0).view;
  assert.deepEqual([read.position, read.lookAt, read.fov], [[0, 0.2, 3.5], [0, 0.2, 0], 58.1]);
  assert.deepEqual(writeCamera(tree, read), []);
  const changed = applied(csg, writeCamera(tree, { ...read, position: [1.23456, 0.2, 3.5] }));
  assert.equal(changed, csg.replace('[0, 0.2, 3.5]', '[1.235, 0.2, 3.5]'));
  for (const [camera, word] of [
    ['{}', 'position'],
    ['{"position": [0, {"expr": "t"}, 1], "look_at": [0, 0, 0]}', 'position'],
    ['{"position": [0, 0, 1], "look_at": {"ahead": 1}}', 'look_at'],
    ['{"position": [0, 0, 1], "look_at": [0, 0, 1]}', 'same point'],
    ['{"position": [0, 0, 1], "look_at": [0, 0, 0], "projection": {"orthographic": {"height": {"expr": "h"}}}}', 'height'],
  ]) {
    const { view: none, reason } = readCamera(parse(`{"scene": {"camera": ${camera}}}`), 0);
    assert.equal(none, null);
    assert.match(reason, new RegExp(word));
  }
  assert.equal(isInGroup(parse('{"scene": {"groups": [{}, {"groups": [{"camera": true}]}]}}')), true);
  assert.equal(isInGroup(tree), false);
  const turning = readCamera(parse('{"frames": {"count": 4}, "scene": {"camera": {"position": [0, 0, 5], "look_at": [0, 0, 0], "turntable": {}}}}'), 1).view;
  const panned = subtract(pan(turning, 0.1, 0).position, turning.position);
  assert.ok(Math.abs(panned[0]) < 1e-9 && panned[2] < 0, 'a quarter turn later, the right is −z');
});

test('faults are marked where they are', () => {
  const text = '{"é𝄞": 1,\n "bla": {"a": 1}}';
  assert.equal(positionOf(text, 1, 1), 0);
  assert.equal(text.slice(positionOf(text, 1, 1 + 2 + 2 + 4)).charAt(0), '"', 'columns count bytes');
  assert.equal(positionOf(text, 9, 1), text.length);
  const mark = markOf(text, parse(text), { pointer: '/bla', message: 'unknown', line: 2, column: 2 });
  assert.equal(text.slice(mark.from, mark.to), '"bla"');
  const end = markOf('{', parse('{'), { pointer: '', message: 'ends', line: 1, column: 2 });
  assert.deepEqual([end.from, end.to], [0, 1]);
});

test('small pictures come first, and a drag asks for small ones alone', () => {
  const wanted = { text: '', frame: 0, layer: 'color', width: 1000, jobWidth: 1920, jobSamples: 64 };
  const costs = (perRay, more = {}) => ({ perRay, overhead: 5, firstLimit: 250, ...more });
  const cheap = stages(wanted, costs(1e-4), false, 9 / 16);
  assert.equal(cheap[0].width, 480);
  assert.deepEqual([cheap.at(-1).width, cheap.at(-1).samples], [1000, 16]);
  assert.ok(cheap[0].limitMs < cheap.at(-1).limitMs);
  const dear = stages(wanted, costs(0.02), false, 9 / 16);
  assert.ok(dear[0].width <= 112 && dear.at(-1).samples === 1);
  assert.equal(stages(wanted, costs(1e-4), true, 9 / 16).length, 1);
  for (const list of [cheap, dear]) list.reduce((before, each) => (assert.ok(each.width >= before.width), each));
  // A scene that takes a second to prepare is worth a first picture that takes a little longer.
  const prepared = stages(wanted, costs(0.002, { overhead: 1000, firstLimit: 4000 }), false, 9 / 16);
  assert.ok(prepared[0].width >= 480 && prepared[0].limitMs === 4000);
  assert.deepEqual([sharper(21, wanted).width, sharper(300, wanted).width, sharper(900, wanted).width, sharper(1000, wanted)], [96, 600, 1000, null]);
  assert.ok(stages({ ...wanted, jobWidth: 32 }, costs(null), false, 1)[0].width <= 32);
});

test('the object of a place is named', () => {
  const text = '{"scene": {"objects": [{"name": "<img src=x>", "shape": {"sphere": {"radius": 1}}}], "materials": {"a": {}}, "lights": [{"sun": {}}]}}';
  const tree = parse(text);
  assert.equal(objectOf(tree, text.indexOf('radius')), 'Object 1: “<img src=x>”');
  assert.equal(objectOf(tree, text.indexOf('"a"')), 'Material a');
  assert.equal(objectOf(tree, text.indexOf('sun')), 'Light 1: sun');
  assert.equal(objectOf(tree, 1), null);
  assert.deepEqual(shownOf(parse('{"image": {"width": 100, "height": 50, "region": [0, 0, 20, 40]}}')).aspect, 2);
  assert.equal(shownOf(parse('{"image": {"width": "x"}}')), null);
});

/** A small table, as `GET /v1/schema/nodes` has it. */
const key = (name, kind, more = {}) => ({ name, kind, of: [], words: [], minimum: null, maximum: null, required: true, default: null, example: null, unit: null, documentation: '', ...more });
const kind = (name, family, keys, example = { [name]: {} }, value = null) => ({ name, family, title: name, documentation: '', keys, is_choice: false, value, example, picture: null });
const shape = (name, more = {}) => ({ kind: name, of: [], words: [], minimum: null, maximum: null, ...more });
const table = new NodeTable({
  kinds: [
    kind('job', 'document', [key('scene', 'object', { of: ['scene'] })]),
    kind('scene', 'document', [
      key('objects', 'objects', { of: ['object'] }),
      key('lights', 'lights', { of: ['light'] }),
      key('materials', 'map', { of: ['material'] }),
      key('background', 'background'),
    ]),
    kind('object', 'document', [key('shape', 'node'), key('material', 'material', { required: false })]),
    kind('track', 'document', [key('keys', 'numberss'), key('ease', 'word', { words: [{ word: 'smooth', documentation: '' }] })]),
    kind('sphere', 'node', [key('radius', 'number', { minimum: 0, maximum: 9, of: ['track'] })], { sphere: { radius: 1 } }),
    kind('union', 'node', [key('of', 'nodes', { of: ['node'] }), key('smooth', 'number', { required: false, default: 0 })]),
    kind('flat', 'material', [key('color', 'color', { of: ['texture'] })], { flat: { color: '#fff' } }),
    kind('point', 'light', [key('position', 'vec3')], { point: { position: [0, 1, 0] } }),
    kind('checker', 'texture', [key('size', 'number')], { checker: {} }),
    kind('color', 'background', [], { color: '#fff' }, shape('color')),
    kind('transparent', 'background', [], 'transparent'),
  ],
});

test('the table says what may stand at a place', () => {
  const text = '{"scene": {"objects": [{"shape": {"union": {"of": [{"sphere": {"radius": 2}}]}}}], "materials": {"a": {"flat": {"color": [1, 2, 3]}}}}}';
  const tree = parse(text);
  const at = (pointerText) => find(tree, pathOfPointer(pointerText));
  assert.deepEqual(table.slotAt(at('/scene/objects/0/shape')), { type: 'family', family: 'node' });
  assert.equal(table.kindAt(at('/scene/objects/0/shape')).name, 'union');
  assert.deepEqual(table.slotAt(at('/scene/objects/0/shape/union/of')), { type: 'list', of: { type: 'family', family: 'node' } });
  assert.equal(table.describe(at('/scene/objects/0/shape/union/of/0/sphere/radius')).key.maximum, 9);
  assert.equal(table.describe(at('/scene/materials/a/flat/color/1')).key.name, 'color');
  assert.deepEqual(table.missingKeys(table.kind('node', 'union'), at('/scene/objects/0/shape/union')).map((each) => each.name), ['smooth']);
  const slotOf = (more, pointerText) => table.slotAt(find(parse(more), pathOfPointer(pointerText)));
  assert.equal(slotOf('{"scene": {"background": {"color": "#fff"}}}', '/scene/background/color').shape.kind, 'color', 'a kind whose value is no object');
  const tracked = '{"scene": {"objects": [{"shape": {"sphere": {"radius": {"keys": [[0, 1]], "ease": "smooth"}}}}], "materials": {"a": {"flat": {"color": {"checker": {"size": 2}}}}}}}';
  assert.equal(slotOf(tracked, '/scene/objects/0/shape/sphere/radius/ease').shape.words[0].word, 'smooth', 'a track in place of a number');
  assert.equal(table.describe(find(parse(tracked), pathOfPointer('/scene/objects/0/shape/sphere/radius/keys/0/1'))).key.name, 'keys');
  assert.equal(slotOf(tracked, '/scene/materials/a/flat/color/checker/size').shape.kind, 'number', 'a texture in place of a color');
  assert.equal(slotOf('{"scene": {"nothing": 1}}', '/scene/nothing'), null);
});

test('an example goes to the cursor, or to its place in the scene', () => {
  const text = '{"scene": {"objects": [{"shape": {"union": {"of": [{"sphere": {"radius": 2}}, {"sphere": {"radius": 3}}]}}}]}}';
  const insert = (family, name, at) => {
    const result = insertExample(text, parse(text), at, table, table.kind(family, name));
    return 'reason' in result ? result.reason : JSON.parse(applied(text, result.changes));
  };
  const between = insert('node', 'sphere', text.indexOf('}, {"sphere') + 1).scene.objects[0].shape.union.of;
  assert.deepEqual(between.map((each) => each.sphere.radius), [2, 1, 3]);
  assert.equal(insert('node', 'sphere', 0).scene.objects.length, 2);
  assert.deepEqual(insert('material', 'flat', 0).scene.materials, { flat: { flat: { color: '#fff' } } });
  assert.deepEqual(insert('light', 'point', 0).scene.lights, [{ point: { position: [0, 1, 0] } }]);
  assert.match(insert('texture', 'checker', 0), /cursor/);
  assert.equal(pretty({ a: 'x'.repeat(100) }, '  '), `{\n    "a": "${'x'.repeat(100)}"\n  }`);
  const points = Array.from({ length: 9 }, (_, at) => [at, 0.5, -1]);
  assert.equal(pretty({ line: { points, width: 1 } }), `{\n  "line": {\n    "points": [\n      ${points.map(compact).join(',\n      ')}\n    ],\n    "width": 1\n  }\n}`);
});
