// The studio’s text: faults, completion, help, formatting, numbers and colors that are held, examples, hostile names.

import assert from 'node:assert/strict';
import { csg, cursorAfter, jobOf, placeOf, setText, settled, studio, textOf, versionOf, stopFarm } from '../studio.js';

export const after = stopFarm;

export async function the_first_visit_shows_a_scene_its_exact_picture_and_that_it_is_valid() {
  const page = await studio({ text: null });
  await page.waitForFunction(() => document.querySelector('.badge')?.textContent === 'Exact');
  await page.waitForSelector('.fault-count.valid');
  assert.match(await page.locator('.plan').textContent(), /about|core/);
  const size = await page.evaluate(() => [document.querySelector('canvas.exact').width, document.querySelector('canvas.exact').height]);
  assert.ok(size[0] >= 480 && Math.abs(size[1] / size[0] - 9 / 16) < 0.01, `${size}`);
}

export async function faults_are_underlined_where_the_server_finds_them_and_go_away() {
  const page = await studio();
  await cursorAfter(page, '"fov');
  await page.keyboard.type('x');
  await page.waitForSelector('.cm-lintRange-error');
  assert.equal(await page.locator('.cm-lintRange-error').first().textContent(), '"fovx"');
  assert.match(await page.locator('.fault-count').textContent(), /error/);
  assert.equal(await page.locator('.badge').textContent(), 'Last valid');
  await page.keyboard.press('F8');
  await page.waitForSelector('.cm-tooltip-lint, .cm-tooltip .cm-diagnostic');
  assert.match(await page.locator('.cm-diagnostic').first().textContent(), /unknown key/);
  await page.keyboard.press('Control+z');
  await page.waitForSelector('.cm-lintRange-error', { state: 'detached' });
  await page.waitForSelector('.fault-count.valid');
}

export async function text_that_is_not_json_is_marked_at_its_place_and_the_picture_stays() {
  const page = await studio();
  await cursorAfter(page, '"name": "csg"');
  await page.keyboard.type('}');
  await page.waitForSelector('.cm-lintRange-error');
  assert.equal(await page.locator('.badge').textContent(), 'Last valid');
  assert.ok(await page.evaluate(() => document.querySelector('canvas.exact').width > 100));
}

export async function warnings_are_shown_too() {
  const page = await studio();
  await setText(page, csg.replace('"name": "csg",', '"name": "csg", "frames": { "count": 3 },'));
  await page.waitForSelector('.fault-count.has-warnings');
}

export async function completion_offers_missing_keys_first_kinds_by_their_family_words_and_names() {
  const page = await studio();
  const offered = async () => {
    await page.waitForSelector('.cm-tooltip-autocomplete li');
    // The list takes no key in its first moments, so that one that was meant for the text does not choose.
    await page.waitForTimeout(120);
    return page.locator('.cm-tooltip-autocomplete .cm-completionLabel').allTextContents();
  };
  await cursorAfter(page, '"sphere": {');
  await page.evaluate(() => {
    const { editor } = document.querySelector('room-studio').studio;
    const at = editor.text.indexOf('"sphere": {') + '"sphere": '.length;
    const end = editor.text.indexOf('}', at) + 1;
    editor.change([{ from: at, to: end, insert: '{  }' }], { cursor: at + 2 });
    editor.view.focus();
  });
  await page.keyboard.press('Control+Space');
  assert.equal((await offered())[0], 'radius');
  await page.keyboard.press('Enter');
  await page.waitForSelector('.cm-tooltip-autocomplete', { state: 'detached' });
  assert.match(await textOf(page), /"sphere": \{\s+"radius": \d/);

  await setText(page, csg);
  await cursorAfter(page, '"material": "cl');
  await page.keyboard.press('Control+Space');
  assert.deepEqual((await offered()).slice(0, 1), ['clay']);
  await page.keyboard.press('Escape');

  await cursorAfter(page, '"format": "');
  await page.keyboard.press('Control+Space');
  const words = await offered();
  assert.ok(words.includes('png') && words.includes('exr'), `${words}`);
  await page.keyboard.press('Escape');

  await setText(page, csg.replace('"shape": {\n          "plane"', '"shape": {  },\n        "x": {\n          "plane"'));
  await cursorAfter(page, '"shape": { ');
  await page.keyboard.type('"tor');
  assert.equal((await offered())[0], 'torus');
  await page.keyboard.press('Enter');
  await page.waitForFunction(() => /"shape": \{ "torus": \{ "radius": [\d.]+, "tube": [\d.]+ \} *\}/.test(document.querySelector('room-studio').studio.editor.text));
}

export async function completion_writes_a_whole_job_that_the_server_takes() {
  const page = await studio();
  await setText(page, '{\n  "scene": {\n    "camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] },\n    "objects": [\n      {  }\n    ]\n  },\n  "image": { "width": 320, "height": 180 }\n}\n');
  await cursorAfter(page, '"objects": [\n      { ');
  const complete = async (label) => {
    await page.keyboard.press('Control+Space');
    await page.waitForSelector('.cm-tooltip-autocomplete li');
    await page.waitForTimeout(120);
    if (label !== undefined) await page.locator('.cm-tooltip-autocomplete li', { has: page.locator(`.cm-completionLabel:text-is("${label}")`) }).click();
    else await page.keyboard.press('Enter');
    await page.waitForSelector('.cm-tooltip-autocomplete', { state: 'detached' });
  };
  await complete('shape');
  await page.waitForSelector('.fault-count.valid');
  const job = await jobOf(page);
  assert.equal(Object.keys(job.scene.objects[0]).join(), 'shape');
}

export async function help_shows_a_kind_with_its_picture_and_a_key_with_its_range() {
  const page = await studio();
  const at = await placeOf(page, '"sphere', 3);
  await page.mouse.move(at.x, at.y);
  await page.waitForSelector('.cm-tooltip-hover .help-panel img');
  assert.match(await page.locator('.cm-tooltip-hover .help-title').textContent(), /sphere/);
  await page.mouse.move(5, 5);
  await cursorAfter(page, '"radius');
  await page.keyboard.press('Alt+h');
  await page.waitForSelector('.help-strip:not([hidden])');
  assert.match(await page.locator('.help-strip').textContent(), /radius.*needed/i);
  await page.keyboard.press('Escape');
  await page.waitForSelector('.help-strip', { state: 'hidden' });
}

export async function formatting_keeps_short_vectors_on_a_line_and_one_undo_takes_it_back() {
  const page = await studio();
  await setText(page, JSON.stringify(JSON.parse(csg)));
  await page.locator('.cm-content').focus();
  await page.keyboard.press('Shift+Alt+f');
  await page.waitForFunction(() => document.querySelector('room-studio').studio.editor.doc.lines > 20);
  assert.match(await textOf(page), /\{ "position": \[0, 0\.2, 3\.5\], "look_at"/);
  await page.keyboard.press('Control+z');
  assert.equal(await textOf(page), JSON.stringify(JSON.parse(csg)));
}

export async function formatting_keeps_comments_and_the_cursor_and_says_why_it_cannot() {
  const page = await studio();
  const format = async () => page.getByRole('button', { name: 'Format', exact: true }).click();
  const beforeCursor = () => page.evaluate(() => {
    const { editor } = document.querySelector('room-studio').studio;
    return editor.text.slice(0, editor.cursor);
  });
  await setText(page, csg.replace('"camera":', '// what is seen\n\n\n"camera"  :').replaceAll('  ', ' '));
  await cursorAfter(page, '58.1');
  await format();
  await page.waitForFunction(() => document.querySelector('room-studio').studio.editor.text.includes('    // what is seen\n\n    "camera": { "position": [0, 0.2, 3.5]'));
  assert.match(await beforeCursor(), /"fov": 58\.1$/);
  await setText(page, csg.replace('"fov": 58.1', '"fov" 58.1'));
  await format();
  await page.waitForSelector('.toast:has-text("colon is missing")');
  assert.equal(await textOf(page), csg.replace('"fov": 58.1', '"fov" 58.1'));
}

export async function a_text_that_changes_while_it_is_formatted_stays_as_it_was_changed() {
  const page = await studio();
  const changed = `${JSON.stringify(JSON.parse(csg))} `;
  await page.route('**/v1/format', async (route) => {
    await setText(page, changed);
    await route.continue();
  });
  const answer = page.waitForResponse('**/v1/format');
  await page.locator('.cm-content').focus();
  await setText(page, JSON.stringify(JSON.parse(csg)));
  await page.keyboard.press('Shift+Alt+f');
  await (await answer).finished();
  await settled(page);
  assert.equal(await textOf(page), changed);
}

export async function folding_search_and_brackets_work_by_keys() {
  const page = await studio();
  await cursorAfter(page, '"camera": {');
  await page.keyboard.press('Control+Shift+BracketLeft');
  await page.waitForSelector('.cm-foldPlaceholder');
  await page.keyboard.press('Control+Shift+BracketRight');
  await page.waitForSelector('.cm-foldPlaceholder', { state: 'detached' });
  assert.ok((await page.locator('.cm-matchingBracket').count()) >= 1);
  await page.keyboard.press('Control+f');
  await page.keyboard.type('position');
  await page.waitForSelector('.cm-searchMatch');
  await page.keyboard.press('Escape');
}

export async function a_number_follows_a_drag_shows_pictures_on_the_way_and_is_one_step_of_undo() {
  const page = await studio();
  await settled(page);
  const at = await placeOf(page, '"fov": 58.1', 3);
  const version = await versionOf(page);
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  for (let step = 1; step <= 20; step += 1) {
    await page.mouse.move(at.x + step * 4, at.y);
    await page.waitForTimeout(15);
  }
  const during = (await jobOf(page)).scene.camera.fov;
  assert.ok(during > 60, `${during}`);
  await page.waitForFunction((old) => Number(document.querySelector('.stage').dataset.version) > old || document.querySelector('.badge.approximate'), version);
  await page.mouse.up();
  await settled(page);
  await page.keyboard.press('Control+z');
  assert.equal(await textOf(page), csg);
  await page.keyboard.press('Control+Shift+z');
  assert.equal((await jobOf(page)).scene.camera.fov, during);
}

export async function a_drag_is_fine_with_shift_keeps_the_range_of_the_table_and_escape_takes_it_back() {
  const page = await studio();
  let at = await placeOf(page, '"fov": 58.1', 3);
  await page.keyboard.down('Shift');
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  await page.mouse.move(at.x + 54, at.y, { steps: 8 });
  const fine = (await jobOf(page)).scene.camera.fov;
  assert.ok(fine > 58.1 && fine < 59.2, `${fine}`);
  await page.keyboard.up('Shift');
  await page.keyboard.press('Escape');
  await page.mouse.up();
  assert.equal(await textOf(page), csg);
  at = await placeOf(page, '"fov": 58.1', 3);
  await page.keyboard.down('Alt');
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  await page.mouse.move(at.x + 600, at.y, { steps: 10 });
  await page.mouse.up();
  await page.keyboard.up('Alt');
  assert.equal((await jobOf(page)).scene.camera.fov, 179);
}

export async function keys_step_numbers_and_the_slider_below_the_text_moves_them() {
  const page = await studio();
  await cursorAfter(page, '"fov": 58.1');
  await page.keyboard.press('Control+.');
  assert.equal((await jobOf(page)).scene.camera.fov, 59.1);
  await page.keyboard.press('Control+,');
  await page.keyboard.press('Control+,');
  assert.equal((await jobOf(page)).scene.camera.fov, 57.1);
  await page.locator('#number-slider').focus();
  await page.keyboard.press('ArrowRight');
  const slid = (await jobOf(page)).scene.camera.fov;
  assert.ok(slid > 57.1 && slid < 60, `${slid}`);
  assert.match(await page.locator('.number-slider label').textContent(), /fov/);
}

export async function the_bracket_of_a_vector_drags_all_its_numbers() {
  const page = await studio();
  const at = await placeOf(page, '"size": [', 1);
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  await page.mouse.move(at.x + 44, at.y, { steps: 6 });
  await page.mouse.up();
  const { size } = (await jobOf(page)).scene.objects[1].shape.difference.of[0].translate.child.box;
  assert.ok(size.every((each) => each > 1.6 && each === size[0]), `${size}`);
}

export async function a_color_is_chosen_in_its_own_notation() {
  const page = await studio();
  const choose = (name, hex) =>
    page.evaluate(([label, value]) => {
      const field = document.querySelector(`input.swatch[aria-label="Color ${label}"]`);
      field.value = value;
      field.dispatchEvent(new Event('input', { bubbles: true }));
      field.dispatchEvent(new Event('change', { bubbles: true }));
    }, [name, hex]);
  await page.waitForSelector('input.swatch[aria-label="Color top"]');
  await choose('top', '#ff0000');
  assert.deepEqual((await jobOf(page)).scene.background.gradient.top, [1, 0, 0]);
  await page.locator('.cm-content').focus();
  await page.keyboard.press('Control+z');
  assert.equal(await textOf(page), csg);
  await setText(page, csg.replace('[0.5, 0.7, 1.0]', '"#80b0ff"'));
  await page.waitForSelector('input.swatch[aria-label="Color top"]');
  await choose('top', '#00ff00');
  assert.equal((await jobOf(page)).scene.background.gradient.top, '#00ff00');
  await cursorAfter(page, '"top": "#00');
  await page.keyboard.press('Alt+c');
  assert.equal(await page.evaluate(() => document.activeElement.className), 'swatch');
}

export async function scenes_and_examples_are_one_click_away() {
  const page = await studio();
  await page.getByRole('button', { name: 'Examples' }).first().click();
  await page.waitForSelector('.kind-item');
  await page.waitForSelector('.scene-item');
  assert.ok((await page.locator('.kind-item').count()) > 60);
  const search = page.getByRole('searchbox');
  await search.fill('torus');
  await page.locator('.kind-item:visible', { hasText: /^torus$/ }).click();
  await page.waitForFunction(() => JSON.parse(document.querySelector('room-studio').studio.editor.text).scene.objects.length === 4);
  await page.waitForSelector('.fault-count.valid, .fault-count.has-warnings');
  assert.ok((await jobOf(page)).scene.objects.at(-1).shape.torus);
  await search.fill('');
  await search.press('ArrowDown');
  const before = await textOf(page);
  await page.keyboard.press('Enter');
  await page.waitForFunction((text) => document.querySelector('room-studio').studio.editor.text !== text, before);
}

export async function every_example_of_every_kind_can_be_inserted_into_a_scene_and_the_server_takes_it() {
  const page = await studio();
  const { count, bad } = await page.evaluate(async (text) => {
    const { insertExample } = await import('/ui/studio/insert.js');
    const { applied } = await import('/ui/studio/edits.js');
    const { parse } = await import('/ui/studio/json.js');
    const { table } = document.querySelector('room-studio').studio;
    // A sun needs a day, and a use of a shape needs that shape.
    const kinds = table.kinds.filter((kind) => kind.example !== null && !['document', 'texture', 'profile'].includes(kind.family) && !['sun', 'use'].includes(kind.name));
    // Things of one scene are inserted into one; of others there is one in a scene.
    const groups = Map.groupBy(kinds, (kind) => (['node', 'material', 'light'].includes(kind.family) ? kind.family : `${kind.family} ${kind.name}`));
    const found = [];
    for (const [name, members] of groups) {
      let changed = text;
      for (const kind of members) {
        const result = insertExample(changed, parse(changed), 0, table, kind);
        if ('reason' in result) found.push(`${kind.name}: ${result.reason}`);
        else changed = applied(changed, result.changes);
      }
      // A projection without a perspective has no field of view.
      if (name.startsWith('projection')) changed = changed.replace(/,\s*"fov": 58.1/, '');
      const response = await fetch('/v1/jobs?dry_run=true', { method: 'POST', headers: { 'content-type': 'application/json' }, body: changed });
      if (!response.ok) found.push(`${name}: ${(await response.json()).detail}`);
    }
    return { count: kinds.length, bad: found };
  }, csg);
  assert.deepEqual(bad, []);
  assert.ok(count > 80, `${count} kinds`);
}

export async function hostile_names_are_text_everywhere() {
  const page = await studio();
  const evil = '<img src=x onerror=globalThis.hacked=1>';
  const job = JSON.parse(csg);
  job.name = evil;
  job.scene.materials[evil] = job.scene.materials.clay;
  job.scene.objects[2].name = evil;
  job.scene.objects[2].material = evil;
  await setText(page, JSON.stringify({ [evil]: 1, ...job }, null, 2));
  await page.waitForSelector('.cm-lintRange-error');
  await page.locator('.cm-content').focus();
  await page.keyboard.press('F8');
  await page.waitForSelector('.cm-diagnostic');
  await setText(page, JSON.stringify(job, null, 2));
  await cursorAfter(page, '"smooth');
  assert.match(await page.locator('.picture-status').textContent(), /<img src=x/);
  await page.evaluate(() => {
    const { editor } = document.querySelector('room-studio').studio;
    editor.show(editor.text.indexOf('"clay",') + 2, { focus: true });
  });
  await page.keyboard.press('Control+Space');
  await page.waitForSelector('.cm-tooltip-autocomplete li');
  await page.locator('.draft').click();
  await page.waitForSelector('.menu');
  await page.keyboard.press('Escape');
  assert.equal(await page.evaluate(() => globalThis.hacked), undefined);
  assert.equal(await page.locator('img[src="x"]').count(), 0);
}
