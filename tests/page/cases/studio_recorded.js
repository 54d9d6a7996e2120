// Renders of a draft that are based on the render before.

import assert from 'node:assert/strict';
import { csg, startFarm, stopFarm, studio } from '../studio.js';

export const after = stopFarm;

export async function renders_only_what_changed_if_asked() {
  // The last render is based on a job that is gone.
  const page = await studio({ text: csg.replace(/"samples": \d+/, '"samples": 1'), expected: [/404.*based_on/] });
  const { address } = await startFarm();
  const choice = page.getByRole('checkbox', { name: 'Only what changed' });
  const render = async () => {
    await page.getByRole('button', { name: 'Render', exact: true }).click();
    await page.waitForURL(/#\/jobs\/[0-9a-f-]{36}/);
    const id = page.url().split('/').at(-1);
    await page.waitForFunction(() => document.querySelector('.state')?.textContent === 'succeeded', null, { timeout: 60_000 });
    return (await fetch(`${address}/v1/jobs/${id}`)).json();
  };
  const edit = async (from, to) => {
    await page.goto(`${address}/#/studio`);
    await page.waitForFunction(() => document.querySelector('room-studio')?.studio?.editor.text.includes('csg'));
    assert.ok(await choice.isChecked(), 'the choice is remembered');
    await page.evaluate(([old, changed]) => {
      const { editor } = document.querySelector('room-studio').studio;
      const at = editor.text.indexOf(old);
      editor.view.dispatch({ changes: { from: at, to: at + old.length, insert: changed } });
    }, [from, to]);
  };
  await choice.focus();
  await page.keyboard.press('Space');
  const first = await render();
  assert.deepEqual([first.recorded, first.based_on, first.tiles_kept], [true, null, 0]);
  await page.getByText('its tiles are kept for edits').waitFor();
  await edit('"name": "csg', '"name": "edited csg');
  const second = await render();
  assert.deepEqual([second.recorded, second.based_on], [true, first.id]);
  await page.getByText('the job before').waitFor();
  // The job before is gone, so that everything is rendered; its room would lead to the list by itself.
  await page.goto(`${address}/#/help`);
  await page.waitForSelector('room-help');
  await fetch(`${address}/v1/jobs/${second.id}`, { method: 'DELETE' });
  await edit('"name": "edited csg', '"name": "again csg');
  const third = await render();
  assert.deepEqual([third.recorded, third.based_on], [true, null]);
}
