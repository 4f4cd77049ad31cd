"""Guards, each with a way to lose it and the tests that must then fail.

``before`` stands exactly once in its file, which a quick test sees to; ``make mutants`` loses one guard
after another in a copy of the tree and runs the tests.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    name: str
    file: str
    before: str
    after: str
    tests: str  #: arguments of pytest
    survives: str = ""  #: why no test can notice, if none can


KERNEL = "kernel/understudy"
ENVIRONMENT = f"{KERNEL}/running/environment.py"
TRAINING = f"{KERNEL}/running/training.py"
CHECKPOINT = f"{KERNEL}/records/checkpoint.py"
RUNS = f"{KERNEL}/records/runs.py"
SIGNALS = f"{KERNEL}/signals.py"
MUJOCO = "plugins/physics/mujoco/understudy_mujoco/simulator.py"
MJCF = "plugins/physics/mujoco/understudy_mujoco/mjcf.py"
CLOTH = "plugins/physics/cloth/understudy_cloth"
PPO = "plugins/learning/ppo/understudy_ppo/learner.py"
OPTIMISERS = "plugins/learning/networks/understudy_networks/optimisers.py"
CLIP = "plugins/figures/motion/understudy_motion/clip.py"
NPZ = "plugins/figures/motion/understudy_motion/readers/npz.py"
F01, F02, F05 = (f"tests/faults/test_0{n}.py" for n in ("1_nonfinite_state", "2_engine_reset", "5_nonfinite_update"))  # fmt: skip
POISON = "tests/faults/test_01_poisoned_fields.py"
F07, F09, F10 = "tests/faults/test_07_killed_while_saving.py", "tests/faults/test_09_damaged_files.py", "tests/faults/test_10_resume.py"  # fmt: skip
F13 = "tests/faults/test_13_stop_signals.py"
LINKS, ENDLESS = "tests/faults/test_22_links.py", "tests/faults/test_24_endless_files.py"
SWEEP_TRIAL, EXECUTORS = (
    "plugins/search/sweeps/understudy_sweeps/trial.py",
    "tests/plugins/sweeps/test_executors.py",
)
POSES, SITTING_TRIALS = (
    "plugins/papers/pose_vae/understudy_pose_vae/job.py",
    "plugins/papers/sitting/understudy_sitting/trials.py",
)
ATTEMPT = "plugins/papers/jumping/understudy_jumping/attempt.py"
FOLDERS, COMPOSITION = f"{KERNEL}/folders.py", f"{KERNEL}/setup/composition.py"
GUARD, GUARDED = (
    "plugins/studio/viewer/understudy_viewer/guard.py",
    "tests/plugins/viewer/test_guard.py",
)
SIZES = "tests/faults/test_27_sizes.py"
UNSOUND, F23 = "tests/faults/test_01_unsound_episodes.py", "tests/faults/test_23_broken_plugins.py"
STATISTICS, PLUGINS, REGISTRY = (
    f"{KERNEL}/running/statistics.py",
    f"{KERNEL}/setup/plugins.py",
    f"{KERNEL}/setup/registry.py",
)
ANY = "tests/faults/test_13_any_moment.py"
F20, FIELDS = "tests/faults/test_20_payloads.py", "tests/faults/test_20_wrong_fields.py"
F06, F08 = "tests/faults/test_06_replay.py", "tests/faults/test_08_disk_full.py"
NN, WARP = (
    "plugins/learning/networks/understudy_networks/nn.py",
    "tests/integration/test_mujoco_warp.py",
)
F24 = "tests/faults/test_24_mutated_models.py"
INPUTS, EVALUATION = f"{KERNEL}/inputs.py", f"{KERNEL}/running/evaluator.py"
TRIAL, APART, MODELS = (
    "plugins/physics/mujoco/understudy_mujoco/trial.py",
    "plugins/physics/mujoco/understudy_mujoco/apart.py",
    "plugins/physics/mujoco/understudy_mujoco/scene.py",
)
JOURNAL, SWEEP, POOL, PROCESSES = (f"plugins/search/sweeps/understudy_sweeps/{n}.py" for n in ("journal", "sweep", "pool", "processes"))  # fmt: skip
F11, SWEEPS = "tests/faults/test_11_other_configuration.py", "tests/plugins/sweeps"
F21, F22, F25 = "tests/faults/test_21_code_in_configurations.py", "tests/faults/test_22_paths.py", "tests/faults/test_25_odd_clips.py"  # fmt: skip

MUTANTS = (
    # Numbers.
    Mutant("a bad control reaches the simulator", ENVIRONMENT,
           "applied = torch.where(good.unsqueeze(1), control, 0.0)", "applied = control", f"{F01} -k control"),
    Mutant("a bad control is no failure", ENVIRONMENT, "self._unsound |= ~good", "pass", f"{F01} -k ctrl"),
    Mutant("the simulator's word is ignored", ENVIRONMENT, "self._unsound |= simulator.failed()", "pass", F02),
    Mutant("the simulator is asked once a decision", ENVIRONMENT, "self._unsound |= simulator.failed()",
           "self._unsound.copy_(simulator.failed())", f"{F02} -k clock"),
    Mutant("marks are forgotten before they are read", MUJOCO, "if self._asked:  # not before", "if True:  # not before",
           f"{F02} -k several_steps"),
    Mutant("marks are never forgotten", MUJOCO, "self._broken[:] = self._asked = False", "pass", f"{F02} -k several_steps"),
    Mutant("a step hides a bad quaternion", "plugins/physics/mujoco_warp/understudy_mujoco_warp/simulator.py",
           "        self._bad |= ~self._sound()\n", "", f"{WARP} -m slow -k bad_world"),
    Mutant("a bad reward is none", ENVIRONMENT, "self._unsound | ~sound(rewards)", "self._unsound", f"{F01} -k derived"),
    Mutant("a bad observation is none", ENVIRONMENT, "unsound = unsound | ~sound(value)", "pass",
           f"{F01} -k derived"),
    Mutant("a bad reward is counted", ENVIRONMENT, "rewards = rewards.masked_fill(unsound, 0.0)", "pass", F01),
    Mutant("last observations are bad", ENVIRONMENT,
           "name: torch.where(rows(step.unsound, value), step.observations[name], value)", "name: value", F01),
    Mutant("first observations are bad", ENVIRONMENT, "name: without_unsound(value) for", "name: value for",
           f"{F01} -k derived"),
    Mutant("records are bad", f"{KERNEL}/running/collector.py", "without_unsound(environment.table[name])",
           "environment.table[name]", POISON),
    Mutant("an index is made of NaN", "plugins/papers/amorphous/understudy_amorphous/maps.py",
           "cell.long().clamp(0, cells - 1)", "cell.clamp(0, cells - 1).long()", POISON),
    Mutant("huge is not bad", ENVIRONMENT, "LARGEST = 1e10", "LARGEST = 1e30", F01),
    Mutant("all worlds' draws are used", ENVIRONMENT, "self._streams.give_back(~worlds, before)", "pass",
           "tests/faults/test_17_determinism.py"),
    Mutant("the engine resets by itself", MUJOCO, "int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)", "0",
           f"{F02} -k not_reset"),
    Mutant("the engine's status is ignored", MUJOCO, "self._broken |= self.batch.status != 0", "pass",
           f"{F02} -k error_of_the_engine"),
    Mutant("the engine's warnings are ignored", MUJOCO, "self._broken |= raised[:, _BAD].any(axis=1)", "pass",
           f"{F02} -k even_if"),
    Mutant("warnings are written", "plugins/physics/mujoco/understudy_mujoco/scene.py",
           "config.logto_file = config.logto_console = False", "pass", f"{F02} -k written_nowhere"),
    Mutant("particles may fly", "plugins/physics/pbd/understudy_pbd/simulator.py", "_EXTENT, _SPEED = 1e3, 1e3",
           "_EXTENT, _SPEED = 1e6, 1e6", "tests/faults/test_04_diverging_particles.py"),
    Mutant("cloth may fly", f"{CLOTH}/simulator.py", "_EXTENT, _SPEED = 1e3, 1e3", "_EXTENT, _SPEED = 1e6, 1e6",
           "tests/plugins/cloth/test_cloth_simulator.py -k fails_alone"),
    Mutant("what was searched is not kept", f"{CLOTH}/simulator.py", '"anchor": (wp.to_torch(c.anchor), (v, 3)),', "",
           "tests/plugins/cloth/test_cloth_simulator.py -k bit_for_bit"),
    Mutant("contact shoots cloth off", f"{CLOTH}/solver.py", "return wp.max(before + change - wp.max(before, 0.0), 0.0)",
           "return 0.0", "tests/plugins/cloth/test_cloth_physics.py -k shot_off"),
    Mutant("a held corner throws", f"{CLOTH}/solver.py", "w = wp.max(w, 0.5 * most)", "w = wp.max(w, 0.0 * most)",
           "tests/plugins/cloth/test_cloth_physics.py -k held_corner"),
    Mutant("a garment's mesh is anywhere", f"{CLOTH}/garments.py",
           "inside = mesh.resolve().is_relative_to(path.parent.resolve())", "inside = True",
           "tests/plugins/cloth/test_garments.py -k link or elsewhere or absolute"),
    Mutant("a garment has holes", f"{CLOTH}/garments.py", "if frozenset(hole.tolist()) not in named:", "if False:",
           "tests/plugins/cloth/test_garments.py -k hole"),
    Mutant("a bad gradient is taken", PPO, "largest = norm(self._row[LOSSES_AND_NORMS], ord=torch.inf)",
           "largest = norm(self._row[3:5], ord=torch.inf)", f"{F05} -k gradient"),
    Mutant("a bad loss is taken", PPO, "sound = largest < torch.inf",
           "sound = torch.ones_like(largest, dtype=torch.bool)", f"{F05} -k loss"),
    Mutant("patience is off by one", OPTIMISERS, "    if bad >= patience:", "    if bad > patience:",
           f"{F05} -k exact"),
    Mutant("the other patience is off by one", "plugins/papers/deepmimic/understudy_deepmimic/curricula.py",
           "self._since >= self._patience", "self._since > self._patience", "tests/plugins/deepmimic -k patience or stagnation or increase"),
    Mutant("a hopeless run goes on", f"{KERNEL}/running/statistics.py", "if share > 0.25:", "if share > 1.0:",
           "tests/kernel tests/faults/test_01_nonfinite_state.py tests/faults/test_05_nonfinite_update.py -k hopeless or quarter"),
    # Checkpoints.
    Mutant("a file is not synced", CHECKPOINT, "            sync(file.fileno())\n", "", f"{F07} -k order"),
    Mutant("a folder is not synced", CHECKPOINT, "            sync(folder)\n", "            pass\n", f"{F07} -k order"),
    Mutant("a file is not flushed", CHECKPOINT, "            file.flush()\n", "", f"{F07} -k order"),
    Mutant("something partial stays", CHECKPOINT, "temporary.unlink(missing_ok=True)", "pass", f"{F07} -k partial"),
    Mutant("tensors have no digest", CHECKPOINT,
           'if digest != document.get("sha256"):', "if False:", f"{F09} {F20}"),
    Mutant("the rest has no digest", CHECKPOINT,
           'if hashlib.sha256(body.encode()).hexdigest() != outer["digest"]:', "if False:", F09),
    Mutant("any format is read", CHECKPOINT, "    if version not in (2, FORMAT):", "    if False:",
           "tests/faults/test_11_other_configuration.py"),
    Mutant("it falls back on nothing", CHECKPOINT, "            reasons.append(str(error))\n",
           "            raise\n", f"{F09} -k falls_back"),
    Mutant("older checkpoints are deleted", CHECKPOINT, "for p in newest(folder)[keep:] if",
           "for p in newest(folder)[1:] if", f"{F09} -k falls_back"),
    Mutant("two processes in a folder", RUNS, "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB",
           "tests/faults/test_12_folders.py"),
    Mutant("unsound episodes are silent", EVALUATION, 'unsound=float(joined["unsound"].float().mean())', "unsound=0.0",
           f"{UNSOUND} -k told"),
    Mutant("a sentence is silent about them", f"{KERNEL}/running/evaluation.py", "        if self.unsound:\n", "        if False:\n", f"{UNSOUND} -k told"),
    Mutant("rows are silent about them", f"{KERNEL}/running/evaluation.py", 'return found | ({f"{kind}/unsound": self.unsound} if self.unsound else {})',
           "return found", f"{UNSOUND} -k told"),
    Mutant("a training of unsound episodes goes on", STATISTICS, "if self._unsound > 0.5 * self._episodes:", "if False:", UNSOUND),
    Mutant("a training of few unsound episodes stops", STATISTICS, "if self._unsound > 0.5 * self._episodes:",
           "if self._unsound > 0:", f"{UNSOUND} -k goes_on"),
    Mutant("few episodes decide", STATISTICS, "if self._episodes >= max(_ENOUGH, self._num_worlds):", "if self._episodes:",
           "tests/kernel/running/test_environment.py -k hopeless"),
    Mutant("no term is named", ENVIRONMENT, "return [where for where, value in values.items() if _wrong(value)]", "return []", UNSOUND),
    Mutant("the page is silent about them", "plugins/showing/report/understudy_report/headline.py",
           "        meaning += _unsound(evaluation)\n", "", "tests/plugins/report/test_report_page.py -k went_wrong"),
    Mutant("a sweep is silent about them", "plugins/search/sweeps/understudy_sweeps/tables.py",
           "figures += [UNSOUND] if UNSOUND in measures_of(results) else []", "pass", f"{SWEEPS}/test_results_page.py -k unsound"),
    Mutant("an import ends every command", PLUGINS, """        except BaseException as error:  # a stranger's import may raise anything
            if is_stop(error):
                raise
""", """        except Exception as error:
""", f"{F23} -k whatever"),
    Mutant("a registration ends every command", PLUGINS, "    except BaseException as error:  # as at import: named, isolated",
           "    except Exception as error:", f"{F23} -k whatever"),
    Mutant("a stop signal counts as a plugin's", SIGNALS, "    return isinstance(error, KeyboardInterrupt) and asked", "    return False",
           f"{F23} -k stop_signal"),
    Mutant("a plugin's interrupt counts as a stop signal", SIGNALS, "    return isinstance(error, KeyboardInterrupt) and asked",
           "    return isinstance(error, KeyboardInterrupt)", f"{F23} -k end"),
    Mutant("an error has to say what it is", f"{KERNEL}/errors.py", """    except BaseException:
        return f"{kind}, which""", """    except ZeroDivisionError:
        return f"{kind}, which""", f"{F23} -k whatever"),
    Mutant("two plugins of a name", PLUGINS, "        if first.value != entry.value:", "        if False:", f"{F23} -k named_like"),
    Mutant("a command that is another's", REGISTRY, "if not typed or c.name in whole | groups or whole & set(above):", "if not typed:",
           f"{F23} -k cannot_be"),
    Mutant("a command that cannot be typed", REGISTRY, "if not typed or c.name in", "if c.name in", f"{F23} -k cannot_be"),
    Mutant("a part without a name", REGISTRY, "    if not typed or not all(isinstance(text, str) for text in texts):", "    if False:",
           f"{F23} -k without_a_name"),
    Mutant("a section that is a key", REGISTRY, "if name in self.registry.slots or name in KERNEL_KEYS:", "if False:",
           f"{F23} -k without_a_name"),
    Mutant("a hook that is none", PLUGINS, "if item in vars(Hooks) and not manager.parse_hookimpl_opts(module, item):", "if False:",
           f"{F23} -k none"),
    Mutant("options that cannot be read", PLUGINS, "elif name not in bundled and (why := _unreadable(file)):", "elif (why := ''):",
           f"{F23} -k cannot_be_read"),
    Mutant("options of any size", PLUGINS, "if root is not None and count(root) > _VALUES else", "if False else",
           f"{F23} -k cannot_be_read"),
    Mutant("a summary is a format", f"{KERNEL}/command/cli.py", 'doubled = text.replace("%", "%%")', "doubled = text", f"{F23} -k per_cent"),
    Mutant("an observer ends a run", TRAINING, "            except BaseException as error:  # it only watches: the run goes on",
           "            except ZeroDivisionError as error:", f"{F23} -k observers_that_end"),
    Mutant("an observer leaves", TRAINING, "            except BaseException as error:  # it only watches: the run goes on",
           "            except Exception as error:", f"{F23} -k observers_that_end"),
    Mutant("what is no observer", PLUGINS, "if not all(isinstance(o, RunObserver) for o in own):", "if False:", f"{F23} -k observers_that_are_none"),
    Mutant("a plugin's observers end a run", PLUGINS, """            except BaseException as error:
                if is_stop(error):
                    raise
                tell(""", """            except Exception as error:
                tell(""", f"{F23} -k observers_that_are_none"),
    Mutant("a count has no end", f"{KERNEL}/options.py", "end = MANY if most is None and", "end = MANY if False and", SIZES),
    Mutant("tuples have no range", f"{KERNEL}/options.py", "given if isinstance(given, tuple) else (given,)", "(given,) if type(given) is not tuple else ()", SIZES),
    Mutant("a decision has no end", f"{KERNEL}/setup/root.py", "if self.substeps * self.decision > _STEPS:", "if False:", f"{SIZES} -k asks"),
    Mutant("an evaluation has no end", f"{KERNEL}/setup/root.py", "if decisions > _DECISIONS:", "if False:", f"{SIZES} -k asks"),
    Mutant("a network of any size", NN, "if sum(a * b for a, b in (*hidden, last)) > LARGEST:", "if False:", f"{SIZES} -k asks"),
    Mutant("layers of any number", "plugins/learning/networks/understudy_networks/policies.py", " or len(units) > 100:", ":", f"{SIZES} -k asks"),
    Mutant("memory that there is not is a defect", f"{KERNEL}/setup/building.py", 'and "memory" not in str(error):', "and True:", f"{SIZES} -k memory"),
    Mutant("particles of any number", "plugins/papers/amorphous/understudy_amorphous/scene.py",
           "if self.blocks * math.prod(self.block) * self.resolution**3 > _PARTICLES:", "if False:", f"{SIZES} -k scene"),
    Mutant("another number of threads is silent", TRAINING, 'if meta.get("threads", threads()) != threads() and', "if False and",
           f"{F11} -k threads"),
    Mutant("a checkpoint does not know its threads", TRAINING, '        meta["threads"] = threads()\n', "", f"{F11} -k threads"),
    Mutant("a page answers any name", GUARD, "return bool(ipaddress.ip_address(name))", "return True", GUARDED),
    Mutant("any name is an address", GUARD, "    return False\n\n\n@contextlib", "    return True\n\n\n@contextlib", GUARDED),
    Mutant("a page answers other pages", GUARD, "or origin.netloc != named[0]", "", GUARDED),
    Mutant("a page answers files", GUARD, 'origin.scheme not in ("http", "https") or', "", GUARDED),
    Mutant("two names of a host", GUARD, "if len(named) != 1 or len(origins) > 1:", "if not named:", GUARDED),
    Mutant("the motion page is open to all", "plugins/studio/viewer/understudy_viewer/page.py", "with guarded(host), contextlib", "with contextlib",
           "tests/plugins/viewer/test_page.py -k own_address"),
    Mutant("the page of a skill is open to all", "plugins/studio/play/understudy_play/page.py", "with guarded(host), contextlib", "with contextlib",
           "tests/plugins/play/test_play.py -k chair"),
    Mutant("options may be anywhere", COMPOSITION, "        if any(map(_leads_out, (group, *names))):", "        if False:", f"{F21} -k elsewhere"),
    Mutant("options may stand at a path", COMPOSITION, 'Path(text).is_absolute() or ".." in Path(text).parts or', "", f"{F21} -k elsewhere"),
    Mutant("options may be resolved", COMPOSITION, ' or "${" in text', "", f"{F21} -k elsewhere"),
    Mutant("a stranger's overrides are resolved", RUNS, '        refuse_resolvers(words[: len(words) - len(more)], f"{self.path}")\n', "", f"{F21} -k resolvers_of"),
    Mutant("resolvers within others", COMPOSITION, "[^}]*(:|\\$\\{)", "[^}]*(:)", f"{F21} -k resolvers_of"),
    Mutant("a journal's overrides are resolved", JOURNAL, '                    refuse_resolvers(event.overrides, "A journal")', "                    pass", f"{F21} -k journal"),
    # What the second attack found to be held by no test.
    Mutant("a harvest keeps what went wrong", "plugins/learning/skills/understudy_skills/harvest.py", "counts & ~step.unsound, step", "counts, step",
           "tests/plugins/skills/test_harvest.py"),
    Mutant("a late trial has no grace", POOL, "                running.deadline += self._limits.grace\n", "", f"{EXECUTORS} -k grace"),
    Mutant("a late trial is not told to save", POOL, """                running.deadline += self._limits.grace
                running.host.save()""", "                running.deadline += self._limits.grace", f"{EXECUTORS} -k grace"),
    Mutant("Ctrl-C reaches the fork server", PROCESSES, "_OF_TERMINALS = {signal.SIGINT, signal.SIGHUP}", "_OF_TERMINALS = {signal.SIGHUP}", f"{EXECUTORS} -k fork_server"),
    Mutant("a terminal's end reaches the fork server", PROCESSES, "_OF_TERMINALS = {signal.SIGINT, signal.SIGHUP}", "_OF_TERMINALS = {signal.SIGINT}", f"{EXECUTORS} -k fork_server"),
    Mutant("a trial is of its sweep's session", PROCESSES, "    os.setsid()  #", "    pass  #", f"{EXECUTORS} -k session"),
    Mutant("nobody waits for who holds a folder", SWEEP_TRIAL, "            if time.monotonic() > deadline:", "            if True:", f"{EXECUTORS} -k waits_for"),
    Mutant("the wait for a folder has no end", SWEEP_TRIAL, "            if time.monotonic() > deadline:", "            if False:", f"{EXECUTORS} -k waits_for"),
    Mutant("a pose network of any shape", POSES, "for misfit in misshapen(dict(network.state_dict()), given, \"network\"):", "for misfit in ():",
           "tests/plugins/pose_vae/test_pose_vae.py -k strangers"),
    Mutant("what is no number fits", f"{KERNEL}/running/warm_start.py", "isfinite()", "isfinite().logical_or(torch.ones(()).bool())",
           "tests/plugins/pose_vae/test_pose_vae.py -k strangers"),
    Mutant("a batch larger than the set", POSES, "size = min(options.batch, len(x))", "size = options.batch", "tests/plugins/pose_vae/test_pose_vae.py -k larger"),
    Mutant("what comes after an episode is near", SITTING_TRIALS, "nearer = running & (distance", "nearer = (distance", "tests/plugins/sitting/test_trials.py"),
    Mutant("what comes after an episode is sitting", SITTING_TRIALS, "found[name] = torch.where(running, longest, found[name])", "found[name] = longest",
           "tests/plugins/sitting/test_trials.py"),
    Mutant("a policy may have more", SITTING_TRIALS, "misfits = misfits or [", "misfits = misfits or [][:0] and [", "tests/plugins/sitting/test_trials.py"),
    Mutant("what has crashed lands", ATTEMPT, "(landed & beyond & ~crashed)", "(landed & beyond)", "tests/plugins/jumping/test_attempt.py"),
    Mutant("a landing is undone", ATTEMPT, '(wrong & (kept["landed"] == 0))', "wrong", "tests/plugins/jumping/test_attempt.py"),
    Mutant("particles forget what varies", "plugins/physics/warp_torch/understudy_warp_torch/world_state.py",
           "        self._put_varied(worlds, snapshot)\n", "", "tests/plugins/pbd/test_pbd_simulator.py -k restored"),
    Mutant("links lead out of a run", RUNS, """        raise RunError(f"{path} is no run folder: it has no run.json.")
    check_within(path)
""", """        raise RunError(f"{path} is no run folder: it has no run.json.")
""", LINKS),
    Mutant("links lead out of a new run", RUNS, "            check_within(self.path)\n", "", f"{LINKS} -k new_runs"),
    Mutant("links lead out of a reproduction", "plugins/search/reproduce/understudy_reproduce/command.py",
           "            check_within(folder)\n", "            pass\n", f"{LINKS} -k new_runs"),
    Mutant("pipes stand in a run", FOLDERS, "elif not stat.S_ISREG(mode):", "elif False:", f"{LINKS} -k pipes"),
    Mutant("a lock follows links", FOLDERS, " | os.O_NOFOLLOW", "", f"{LINKS} -k lock"),
    Mutant("a lock empties", FOLDERS, "os.O_RDWR | os.O_CREAT", "os.O_RDWR | os.O_CREAT | os.O_TRUNC", f"{LINKS} -k lock"),
    Mutant("a folder that is another by now", RUNS, "held = os.path.samestat(", "held = bool(os.lstat(self.path / '.lock')) or (",
           "tests/faults/test_12_folders.py -k gone"),
    Mutant("a checkpoint into another's folder", TRAINING, "        run.check_held()\n", "", "tests/faults/test_12_folders.py -k gone"),
    Mutant("a pipe is waited for", FOLDERS, "        if not stat.S_ISREG(found.st_mode):", "        if False:", ENDLESS),
    Mutant("a file of nothing is read", FOLDERS, "if found.st_size > most:", "if False:", ENDLESS),
    Mutant("a row has no end", RUNS, "file.readline(_ROW)", "file.readline()", f"{ENDLESS} -k row"),
    Mutant("tensors are read before their digest", CHECKPOINT,
           'hashlib.file_digest(tensor_bytes, "sha256")', 'hashlib.sha256(tensor_bytes.read())', f"{ENDLESS} -k tensors"),
    Mutant("an input is read before its digest", INPUTS, 'hashlib.file_digest(file, "sha256")', 'hashlib.sha256(file.read())',
           f"{ENDLESS} -k inputs"),
    Mutant("rows are doubled", RUNS, '<= iteration]', '<= iteration + 5]',
           "tests/faults/test_14_requeued_jobs.py -k anew"),
    Mutant("state of another kind is loaded", TRAINING, '            for misfit in misshapen(own, {**state, "progress": progress}, ""):\n                raise ValueError(misfit)\n', "",
           FIELDS),
    Mutant("NaN is loaded", f"{KERNEL}/running/warm_start.py", "if finite == [True, False]:",
           "if False:", FIELDS),
    Mutant("any moments are loaded", OPTIMISERS,
           "if value.shape != shape or value.dtype != torch.float32 or not value.isfinite().all():", "if False:",
           "tests/plugins/networks/test_optimisers.py -k moments"),
    # Resuming.
    Mutant("streams are not restored", ENVIRONMENT, 'self._streams.load_state_dict(state["streams"])', "pass", F10),
    Mutant("initial states are not restored", ENVIRONMENT,
           'parts.initial_states.load_state_dict(state["initial_states"])', "pass", f"{F10} -k adapted"),
    Mutant("episode fields are not restored", ENVIRONMENT, 'value.copy_(state["tensors"][name])',
           'value.copy_(state["tensors"][name]) if "constant" not in name else None', f"{F10} -k adapted"),
    Mutant("statistics are not restored", ENVIRONMENT, 'self.statistics.load_state_dict(state["statistics"])',
           "pass", F10),
    Mutant("the simulation is not restored", ENVIRONMENT, 'parts.simulator.restore(state["simulator"])', "pass", F10),
    Mutant("the adapted rate is not restored", PPO,
           'self._rate, self._coefficient = state["actor_rate"], state["kl_coefficient"]',
           'self._coefficient = state["kl_coefficient"]', f"{F10} -k adapted"),
    Mutant("the learner's draws are not restored", PPO, 'self._generator.set_state(state["generator"].cpu())',
           "pass", F10),
    Mutant("the actions' draws are not restored", f"{KERNEL}/running/reinforcement.py",
           'self.collector.streams.load_state_dict(state["collector"])', "pass", F10),
    # Stop signals.
    Mutant("a closed terminal is not noted", SIGNALS, "signal.SIGUSR1, signal.SIGHUP)", "signal.SIGUSR1)",
           f"{ANY} -k terminal"),
    Mutant("nohup is ignored", SIGNALS, "signal.getsignal(signal.SIGHUP) is signal.SIG_IGN", "False",
           f"{ANY} -k nohup"),
    Mutant("what came at the end is lost", SIGNALS, "if self.received is not None and kind is not PreemptedError:",
           "if False:", f"{ANY} -k nest"),
    Mutant("what came before is lost", SIGNALS,
           "self.received = self._nested[-1].received if self._nested else None", "pass", f"{ANY} -k nest"),
    Mutant("an evaluation is lost", TRAINING, "progress.pending = row", "pass", f"{F13} -k doubled"),
    Mutant("an evaluation holds a signal up", TRAINING, "with StopRequest(at_once=True):", "with StopRequest():",
           f"{F13} -k doubled"),
    Mutant("a defect hides the signal", f"{KERNEL}/command/cli.py",
           "if stop.received is not None and not isinstance(error, PreemptedError):",
           "if isinstance(error, KeyboardInterrupt):", f"{ANY} -k library"),
    Mutant("a closed terminal ends it", f"{KERNEL}/command/workflow.py",
           "contextlib.suppress(OSError):  # a terminal that was closed stops nothing", "contextlib.nullcontext():",
           f"{ANY} -k printed"),
    # Data from strangers.
    Mutant("lists may name code", f"{KERNEL}/setup/validation.py", 'refuse_code(item, f"{where}[{i}]")', "pass", F21),
    Mutant("code may be named", f"{KERNEL}/setup/validation.py", "if key in CODE_KEYS:", "if False:", F21),
    Mutant("run folders may name code", RUNS, "        refuse_code(config)\n", "", F21),
    Mutant("options may be infinite", f"{KERNEL}/options.py", "if not math.isfinite(value):", "if False:",
           "tests/faults/test_27_invalid_values.py"),
    Mutant("a clip's time may be NaN", CLIP, 'self._require(times.isfinite(), "time is not a finite number")',
           "pass", f"{F25} -k none"),
    Mutant("a clip's place may be NaN", CLIP,
           'self._require(position.isfinite().all(-1), "root position is not finite")', "pass", f"{F25} -k none"),
    Mutant("a clip's rotation may be NaN", CLIP,
           'self._require(rotation.isfinite().all(-1).all(-1), "a rotation is not finite")', "pass", f"{F25} -k none"),
    Mutant("JSON may be infinite", "plugins/figures/motion/understudy_motion/readers/deepmimic.py",
           "finite = np.isfinite(rows)", "finite = np.ones(rows.shape, bool)", f"{F25} -k json"),
    Mutant("arrays may be NaN", NPZ, "finite = np.isfinite(array)\n", "finite = np.ones(array.shape, bool)\n", f"{F25} -k arrays"),
    Mutant("arrays may be of any size", NPZ, "if member.file_size > self._left:", "if False:", f"{F25} -k arrays"),
    Mutant("each array has the limit alone", NPZ, "self._left -= member.file_size", "pass", f"{F25} -k arrays"),
    Mutant("absolute paths of models", MJCF, 'if Path(name).is_absolute() or "\\\\" in name:', "if False:", F22),
    Mutant("models that leave their folder", MJCF, "if not path.is_relative_to(self._root):", "if False:", F22),
    Mutant("plugins of models", MJCF, "if element.tag in _REFUSED:", "if False:", F22),
    Mutant("models that include themselves", MJCF, "            if path in within:", "            if False:", F22),
    Mutant("entities of models", MJCF, 'if "<!DOCTYPE" in text or "<!ENTITY" in text or "\\0" in text:',
           "if False:", F22),
    Mutant("models of any size", MJCF, "if len(content) > limit:", "if False:", F22),
    Mutant("a broken plugin stays", f"{KERNEL}/setup/plugins.py", "plugins.registry.remove(plugin.name)", "pass",
           "tests/faults/test_23_broken_plugins.py"),
    # What a run carries, and which runs are read.
    Mutant("a carried file is not compared", INPUTS,
           "if not inside or _digest(path) != digest:", "if not inside:",
           "tests/kernel/test_inputs.py"),
    Mutant("a carried file may be elsewhere", INPUTS,
           "path.resolve().is_relative_to(self.folder.resolve()) and path.is_file()", "path.is_file()",
           "tests/kernel/test_inputs.py"),
    Mutant("the original is read again", INPUTS, "if asked not in self.kept:", "if True:", "tests/kernel/test_inputs.py"),
    Mutant("any layout is read", RUNS, "    if layout != LAYOUT:", "    if False:", F11),
    Mutant("older layouts are called newer", RUNS, "if isinstance(layout, int) and layout < LAYOUT:", "if False:", F11),
    # Evaluations.
    Mutant("evaluations repeat their draw", TRAINING, 'draw = f"{kind}/{self.progress.evaluations + 1}"', "draw = kind",
           "tests/kernel/running/test_evaluations.py"),
    Mutant("one draw meets the criterion", TRAINING, "met, row = _reaches(second, options.criterion),", "met, row = True,",
           "tests/kernel/running/test_evaluations.py"),
    Mutant("an evaluation cut short meets it", TRAINING, "return evaluation.complete and rate", "return rate",
           "tests/kernel/running/test_evaluations.py"),
    Mutant("the last start decides", EVALUATION, "in reversed(self._starts.items()):", "in self._starts.items():",
           "tests/kernel/running/test_evaluation_starts.py"),
    Mutant("all starts are judged for a criterion", EVALUATION, "if give_up_below is None and self.success:", "if self.success:",
           "tests/kernel/running/test_evaluation_starts.py"),
    Mutant("measures of episodes that still run are final", EVALUATION, "int((~self._running & ~self._won())", "int((~self._won())",
           "tests/kernel/running/test_evaluations.py -k final"),
    Mutant("the measures of a bad world count", EVALUATION, "counted = running & ~step.unsound", "counted = running",
           "tests/kernel/running/test_evaluations.py -k wrong"),
    # Sweeps.
    Mutant("the journal is not synced", JOURNAL, "                sync(file.fileno())\n", "", f"{SWEEPS}/test_journal.py"),
    Mutant("a lost row of the journal is none", JOURNAL, "        self.events.append(event)\n", "",
           f"{SWEEPS}/test_journal.py {SWEEPS}/test_sweep.py"),
    Mutant("a row cut short stays", JOURNAL, "if not path.exists() or read(path, _MOST) != rows:", "if not path.exists():",
           f"{SWEEPS}/test_journal.py {SWEEPS}/test_sweep.py"),
    Mutant("a trial is asked for twice", JOURNAL, "if any(trial.key == other.key for other in self.asked):", "if False:",
           f"{SWEEPS}/test_journal.py"),
    Mutant("two processes write a journal", SWEEP, "        book.lock()\n", "", SWEEPS),
    Mutant("two sweeps share a folder", SWEEP, "if not same and not grown:", "if False:", f"{SWEEPS}/test_sweep.py"),
    Mutant("another component counts as an option", SWEEP, "isinstance(value, Mapping) and \"name\" in value for", "False for",
           f"{SWEEPS}/test_sweep.py -k older"),
    Mutant("reports are told twice", SWEEP, "new = report.final or (report.key, report.cost) not in self._told", "new = True",
           f"{SWEEPS}/test_sweep.py"),
    Mutant("what is learned again is told again", SWEEP, " and report.key not in self.again:", ":", f"{SWEEPS}/test_sweep.py -k gone"),
    Mutant("early stops are forgotten", SWEEP, "self._stopped[report.key] = report.cost", "pass", f"{SWEEPS}/test_sweep.py -k early"),
    Mutant("trials take for ever", POOL, "if running.deadline is None or time.monotonic() < running.deadline:", "if True:",
           f"{SWEEPS}/test_executors.py"),
    Mutant("a killed trial is lost", POOL, "if running.tries < limit:", "if False:", f"{SWEEPS}/test_executors.py"),
    Mutant("a killed trial is tried for ever", POOL, "if running.tries < limit:", "if True:", f"{SWEEPS}/test_executors.py -k gives_up"),
    Mutant("trials outlive their sweep", PROCESSES, "    except (EOFError, OSError):\n        end()\n", "    except (EOFError, OSError):\n        time.sleep(3600)\n",
           f"{SWEEPS}/test_executors.py -k children"),
    Mutant("a library keeps a signal", SIGNALS, "if signal.getsignal(number) is not _note:", "if number not in self._previous:",
           F13),
    # Models that compute without end.
    Mutant("a model is not tried first", MODELS, "        try_out(folder / own.name, folder if kept else root, self._mjcf)\n", "", f"{F24} -k leaves"),
    Mutant("a model may compute for ever", APART, "    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))\n", "",
           f"{F24} -k without_end"),
    Mutant("a model may take all memory", APART, "    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))\n", "",
           f"{F24} -k without_end"),
    Mutant("a model may hang", APART, "            timeout=bounds.wall, env=alone,\n", "            env=alone,\n",
           f"{F24} -k ends_or_stops"),
    Mutant("a model that crashes MuJoCo passes", APART, "    if done.returncode:\n", "    if done.returncode == _REFUSED:\n",
           f"{F24} -k ends_or_stops"),
    Mutant("a changed model is not tried again", TRIAL, "digest = hashlib.sha256(model.text.encode())", "digest = hashlib.sha256()",
           f"{F24} -k tried_once"),
    Mutant("the working folder is imported", APART, 'sys.executable, "-P", "-m",', 'sys.executable, "-m",',
           f"{F24} -k working_folder"),
    Mutant("models of any depth", MJCF, "        if depth > MAX_DEPTH:", "        if False:", F22),
    Mutant("includes of any depth", MJCF, "self._include(included, (*within, path), path.parent, depth + 1)",
           "self._include(included, (*within, path), path.parent)", f"{F22} -k within"),
    # What else must hold.
    Mutant("dropped contacts are not counted", "plugins/physics/mujoco_warp/understudy_mujoco_warp/simulator.py",
           "        self._overflows += ((self._overflow & self._dropping) != 0).sum()\n", "", f"{WARP} -m slow -k overflow"),
    Mutant("the GPU's controls do not arrive", "plugins/physics/mujoco_warp/understudy_mujoco_warp/simulator.py",
           '        self._views["ctrl"].copy_(control)\n', "", f"{WARP} -m slow -k agrees"),
    Mutant("a dump is replayed from elsewhere", "plugins/showing/inspect/understudy_inspect/replay.py",
           'simulator.restore(snapshot)', "pass", F06),
    Mutant("what hardly varies is blown up", NN, "torch.rsqrt(self.variance + 1e-4)", "torch.rsqrt(self.variance)", f"{F06} -k normaliser"),
    Mutant("normalised values are of any size", NN, ".clamp(-self.clip, self.clip)", "", f"{F06} -k normaliser"),
    Mutant("the normaliser stops learning", NN, "total.clamp(max=self.horizon)", "total", f"{F06} -k normaliser"),
    Mutant("metrics that do not fit are a traceback", RUNS,
           "                file.write(json.dumps(row) + \"\\n\")\n        except OSError as error:",
           "                file.write(json.dumps(row) + \"\\n\")\n        except ZeroDivisionError as error:", f"{F08} -k status_2"),
    Mutant("a dump that does not fit stops the run", TRAINING, "except RunError as error:  # the training can go on",
           "except ZeroDivisionError as error:  # the training can go on", f"{F08} -k dump"),
    Mutant("damaged archives are a traceback", NPZ, "except Exception as error:  # zipfile raises",
           "except ZeroDivisionError as error:  # zipfile raises", "tests/faults/test_24_mutated_clips.py"),
    Mutant("the phase does not wrap", "plugins/figures/characters/understudy_characters/reference.py",
           '(local / self.duration).clamp(0.0, 1.0 - 1e-6)', "local * 2", "tests/faults/test_26_laws.py -k phase"),
    Mutant("advantages go on over an episode's end", "plugins/learning/networks/understudy_networks/returns.py",
           "decay = gamma * lam * continues", "decay = gamma * lam + 0 * continues", "tests/plugins/networks/test_returns.py"),
    Mutant("descriptors leak", RUNS, '            with open(self.metrics_file, "a", encoding="utf-8") as file:\n',
           '            file = open(self.metrics_file, "a", encoding="utf-8", buffering=1)\n            [os.dup(file.fileno()) for _ in range(20)]\n            if True:\n',
           "tests/faults/test_28_soak.py"),
    Mutant("plugins load torch", f"{KERNEL}/setup/plugins.py", "import pluggy\n", "import pluggy\nimport torch\n",
           "tests/faults/test_30_cold_start.py"),
    Mutant("a home is needed", f"{KERNEL}/setup/plugins.py", 'GROUP = "understudy"\n',
           'GROUP = "understudy"\n(Path.home() / ".understudy").mkdir(exist_ok=True)\n', "tests/faults/test_30_cold_start.py"),
    Mutant("a cache that cannot be written is used", "plugins/physics/warp_torch/understudy_warp_torch/kernels.py",
           "    wp.config.kernel_cache_dir = temporary\n", "", "tests/plugins/warp_torch/test_kernels.py"),
    # The rest.
    Mutant("a diverged environment is measured", "benchmarks/cpu.py", 'if int(environment.quarantined):',
           "if False:", "tests/faults/test_29_invalid_benchmarks.py"),
    Mutant("a diverged simulation is measured", "benchmarks/cpu.py",
           'if not np.isfinite(bare.bind("qpos")).all():', "if False:", "tests/faults/test_29_invalid_benchmarks.py"),
    Mutant("global random numbers are used", f"{KERNEL}/random.py", "with torch.random.fork_rng(devices=[]):",
           "if True:", "tests/faults/test_18_global_random_state.py"),
    Mutant("processes wait for half an hour", f"{KERNEL}/distributed.py", ", timeout=patience)", ")",
           "tests/faults/test_15_lost_workers.py -m slow -k 19-1"),
    # Grips.
    Mutant("contact settings are ignored", MODELS, "        self.contact.apply(spec)\n", "", "tests/plugins/mujoco/test_contact.py"),
    Mutant("noslip goes with any integrator", "plugins/physics/mujoco/understudy_mujoco/contact.py",
           'if option.integrator == _INTEGRATORS["discrete"] and option.noslip_iterations:', "if False:",
           "tests/plugins/mujoco/test_contact.py"),
    Mutant("fingers may cross", "plugins/figures/gripping/understudy_gripping/styles.py", "if above > below:", "if False:",
           "tests/plugins/gripping/test_styles.py"),
    Mutant("a grip of another hand is taken", "plugins/figures/gripping/understudy_gripping/grip.py",
           "if scene.measures != self.measures:", "if False:", "tests/plugins/gripping/test_grip.py -k another_hand"),
    Mutant("a grip that falls is written", "plugins/figures/gripping/understudy_gripping/grip.py",
           "if (fell := grip.held(scene, row, 1.0).fell) is not None:", "if (fell := None) is not None:",
           "tests/plugins/gripping/test_grip.py -k fall"),
)  # fmt: skip
