// Types of what the API returns. There is no code here.

/**
 * @typedef {'queued' | 'running' | 'succeeded' | 'failed' | 'cancelled'} JobState
 * @typedef {{done: number, total: number}} DoneOfTotal
 *
 * @typedef {object} Job
 * @property {string} id
 * @property {string} name
 * @property {string} submitter
 * @property {number} priority
 * @property {JobState} state
 * @property {boolean} paused
 * @property {number} progress
 * @property {DoneOfTotal} tiles
 * @property {DoneOfTotal} frames
 * @property {string[]} errors
 * @property {string[]} warnings
 * @property {string} created_at
 * @property {string | null} started_at
 * @property {string | null} finished_at
 * @property {number | null} eta_seconds
 * @property {number | null} [queue_position]
 * @property {boolean} recorded
 * @property {string | null} based_on
 * @property {number} tiles_kept
 *
 * @typedef {{jobs: Job[], next_cursor: string | null}} JobPage
 *
 * @typedef {object} FarmCounts
 * @property {boolean} paused
 * @property {number} queued
 * @property {number} running
 * @property {number} succeeded
 * @property {number} failed
 * @property {number} cancelled
 * @property {number} workers_ready
 *
 * @typedef {'waiting' | 'open' | 'stitching' | 'stored' | 'void'} FrameState
 * @typedef {{number: number, state: FrameState, picture: string | null, size_bytes: number | null, image: string | null, file: string | null}} Frame
 *
 * @typedef {object} TileLease
 * @property {string} worker
 * @property {string} worker_name
 * @property {string} device
 * @property {string} started_at
 * @property {string | null} ended_at
 * @property {string | null} outcome
 * @property {number | null} seconds
 *
 * @typedef {object} Tile
 * @property {number} frame
 * @property {number} x
 * @property {number} y
 * @property {number} width
 * @property {number} height
 * @property {'ready' | 'leased' | 'done' | 'dead' | 'void'} state
 * @property {number} attempts
 * @property {TileLease[]} leases
 *
 * @typedef {object} Worker
 * @property {string} id
 * @property {string} name
 * @property {string} device
 * @property {string} state
 * @property {number | null} rays_per_second
 * @property {number} leases
 * @property {boolean} [pool]
 * @property {string} [registered_at]
 * @property {string} [last_seen_at]
 * @property {boolean} [quarantined]
 * @property {boolean} [draining]
 * @property {number} [errors]
 * @property {string | null} [last_error]
 * @property {{job: string, name: string, frame: number, tiles: number}[]} [holds]
 *
 * @typedef {object} HistoryPoint
 * @property {string} at
 * @property {number} rays
 * @property {number} tiles
 * @property {number} frames
 * @property {number} workers
 * @property {number} busy
 * @property {number} queued_tiles
 * @property {number} jobs_queued
 * @property {number} jobs_running
 *
 * @typedef {{step_seconds: number, points: HistoryPoint[]}} History
 * @typedef {{code: string, severity: 'warning' | 'critical', message: string, cure: string, since: string | null}} Alert
 *
 * @typedef {object} Key
 * @property {string} id
 * @property {string} name
 * @property {string[]} scopes
 * @property {string} state
 * @property {string} created_at
 * @property {string | null} expires_at
 * @property {string | null} last_used_at
 *
 * @typedef {object} AuditEntry
 * @property {number} number
 * @property {string} at
 * @property {string} who
 * @property {string | null} key
 * @property {string} address
 * @property {string} method
 * @property {string} route
 * @property {string | null} job
 * @property {number} status
 * @property {string | null} code
 * @property {string} request_id
 * @property {number} times
 *
 * @typedef {object} KindKey
 * @property {string} name
 * @property {string} kind
 * @property {boolean} required
 * @property {unknown} default
 * @property {number | null} [minimum]
 * @property {number | null} [maximum]
 * @property {string | null} [unit]
 * @property {string} documentation
 *
 * @typedef {object} Kind
 * @property {string} name
 * @property {string} family
 * @property {string} title
 * @property {string} documentation
 * @property {KindKey[]} keys
 * @property {unknown} example
 * @property {string | null} picture
 */

export {};
