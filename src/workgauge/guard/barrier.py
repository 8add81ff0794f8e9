"""The barrier guard: as fast as still stops in time, verified by rolling the stop out before a command leaves."""
from dataclasses import dataclass
import math
import numpy as np
from workgauge.guard.api import *
from workgauge.guard.cushion import cushioned
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.rollout import Rollout
import daqp

@dataclass
class Barrier:
    rollout: Rollout
    stop: float = 0.2
    margin: float = 0.005
    ease_s: float = 0.1
    spacing: float = 0.3
    most: int = 12
    far: float = 3.0
    levers: np.ndarray = None   # (n,) max lever arm bound per joint [m]
    stats: dict = None
    corners: object = None
    between: bool = True
    band: float = 0.5
    ends: bool = True

    def start(self):
        return {'v': self.rollout.rest(), 'sent': np.zeros((self.rollout.memory, self.rollout.n)), 'group': -1}

    def allow(self, given, memory):
        r = self.rollout
        sent = np.vstack([memory['sent'][1:], given.sent])
        v = r.advanced(memory['v'], sent)
        names = given.joint_names
        vel, reasons = within_speed(given.desired.tolist(), given.speed_positive.tolist(), given.speed_negative.tolist(), names)
        want = np.array(vel)
        low, high = r.displacements(v, sent, np.stack([np.zeros(r.n), want]))
        if self.ends:
            a, b = given.q_min - given.q, given.q_max - given.q
            low, high = np.clip(low, np.minimum(a,0), np.maximum(b,0)), np.clip(high, np.minimum(a,0), np.maximum(b,0))
        # cushion at predicted rest
        rest = given.q + np.where(np.abs(low[0,-1])>np.abs(high[0,-1]), low[0,-1], high[0,-1])
        vel, ends = cushioned(want.tolist(), rest.tolist(), (given.q_min.tolist(), given.q_max.tolist()), (given.speed_positive.tolist(), given.speed_negative.tolist()), names, dt_s=given.dt_s, cushion_s=0.3, keep_direction=given.keep_direction)
        vel = np.array(vel)
        if (vel != want).any():
            want = vel
            low, high = r.displacements(v, sent, np.stack([np.zeros(r.n), want]))
            if self.ends: low, high = np.clip(low, np.minimum(a,0), np.maximum(b,0)), np.clip(high, np.minimum(a,0), np.maximum(b,0))
        mem = {'v': v, 'sent': sent, 'group': -1}
        if not want.any():
            return want, mem, None
        rows, slack, covered, nq, samples = self.constraints(given, want, low, high)
        self.stats['queries'] = self.stats.get('queries', 0) + nq
        self.stats['ticks'] = self.stats.get('ticks', 0) + 1
        s = self.programme(rows, slack, given.keep_direction, r.n)
        if not covered:
            self.stats['uncovered'] = self.stats.get('uncovered', 0) + 1
            s = np.zeros(r.n)
        f0 = None
        if s.min() < 1.0 and s.any():
            f0 = self.least(given, np.zeros(r.n), v, sent, samples)
            for attempt in range(4):
                self.stats['verify'] = self.stats.get('verify', 0) + 1
                f = self.least(given, want * s, v, sent, samples)
                self.stats['queries'] += len(samples)
                if f >= min(0.0, f0) - 1e-7:
                    break
                self.stats['refused'] = self.stats.get('refused', 0) + 1
                s = s * 0.5 if attempt < 2 else s * 0.0
        return want * s, mem, (rows, slack)

    def least(self, given, command, v, sent, samples):
        low, high = self.rollout.displacements(v, sent, command[None])
        low, high = self.clip(given, low[0]), self.clip(given, high[0])
        worst = np.where(np.abs(low) > np.abs(high), low, high)
        least = 9.0
        for m in samples:
            c, rows = given.look(given.q + worst[m], 1.0)
            if not len(c): continue
            own = c.stop_distances
            d = c.distances - c.protections - np.where(np.isnan(own), self.stop, own) - self.margin
            pos, neg = np.maximum(rows, 0), np.minimum(rows, 0)
            least = min(least, float((d + pos @ (low[m] - worst[m]) + neg @ (high[m] - worst[m])).min()))
        return least

    def clip(self, given, d):
        return np.clip(d, np.minimum(given.q_min - given.q, 0), np.maximum(given.q_max - given.q, 0)) if self.ends else d

    def constraints(self, given, want, low, high):
        """rows (K, n) in share of want, slack (K)."""
        lo0, lo1, hi0, hi1 = low[0], low[1], high[0], high[1]
        dlo, dhi = lo1 - lo0, hi1 - hi0
        worst = np.where(np.abs(lo1) > np.abs(hi1), lo1, hi1)   # (M,n)
        m_first = int(np.argmax((np.abs(dlo) + np.abs(dhi)).sum(1) > 1e-12))
        travel = np.abs(np.diff(worst, axis=0)) @ self.levers
        travel = np.concatenate([[np.abs(worst[0]) @ self.levers], travel]).cumsum()
        end = travel[-1]
        m, rows_all, slack_all, n_q, seen = m_first, [], [], 0, []
        M = len(worst)
        previous = m_first
        while True:
            n_q += 1; seen.append(m)
            q = given.q + worst[m]
            radius = min(end - travel[m] + self.stop + 0.6, self.far)
            c, rows = given.look(q, radius)
            free = radius
            nxt = m
            if len(c):
                own = c.stop_distances
                stops = np.where(np.isnan(own), self.stop, own)
                d = c.distances - c.protections - stops - self.margin
                free = float(d.min())
            nxt = min(max(int(np.searchsorted(travel, travel[m] + max(self.spacing, free), side='right')) - 1, m + 1), M - 1)
            if len(c):
                if self.corners is not None:
                    h, hr, which = self.corners(q, c, d < self.band)
                    d = np.concatenate([d, h - c.protections[which] - stops[which] - self.margin])
                    rows = np.vstack([rows, hr])
                pos, neg = np.maximum(rows, 0), np.minimum(rows, 0)
                last = M if m == M - 1 else min(nxt, m + 6)
                for k in (range(previous + 1, last) if self.between else (m,)):
                    slack = d + pos @ (lo0[k] - worst[m]) + neg @ (hi0[k] - worst[m])
                    A = pos * dlo[k] + neg * dhi[k]
                    need = np.minimum(A, 0).sum(1) + self.use * np.maximum(slack, 0) < 0
                    if need.any():
                        rows_all.append(A[need]); slack_all.append(slack[need])
            if m == M - 1:
                covered = True; break
            if n_q >= self.most:
                covered = False; break
            previous, m = m, nxt
        if rows_all:
            return np.vstack(rows_all), np.concatenate(slack_all), covered, n_q, seen
        return np.zeros((0, len(want))), np.zeros(0), covered, n_q, seen

    @property
    def use(self):
        return min(1.0, self.rollout.dt_s / self.ease_s)

    def programme(self, A, slack, keep, n):
        if not len(A):
            return np.ones(n)
        b = -self.use * np.maximum(slack, 0)
        if keep:
            t = A.sum(1)
            bad = t < 0
            s = float(np.min(b[bad] / t[bad], initial=1.0))
            return np.full(n, max(min(s, 1.0), 0.0))
        if (A.sum(1) >= b).all():
            return np.ones(n)
        self.stats['qp'] = self.stats.get('qp', 0) + 1
        scale = 1.0 / np.maximum(np.abs(A).max(axis=1), 1e-12)
        A_, b_ = A * scale[:, None], b * scale
        x, f, flag, info = daqp.solve(np.eye(n), -np.ones(n), np.ascontiguousarray(A_), np.concatenate([np.ones(n), np.full(len(b_), 1e30)]), np.concatenate([np.zeros(n), b_]))
        if flag != 1:
            self.stats['fail'] = self.stats.get('fail', 0) + 1
            return np.zeros(n)
        x = np.clip(x, 0, 1)
        if (A_ @ x < b_ - 1e-6).any():
            self.stats['unchecked'] = self.stats.get('unchecked', 0) + 1
            return np.zeros(n)
        return x
