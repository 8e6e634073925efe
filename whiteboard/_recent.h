/* The latest messages of each writer of a slot, included by _shm.c. */

/* recent(): (count, stamp, process) of each message that a writer's buffers hold, in no order. */
static PyObject *port_recent(Port *self, PyObject *unused)
{
    (void)unused;
    if (!is_open(self->board, self->name))
        return NULL;
    PyObject *all = PyList_New(0);
    if (port_renew(self, false)) /* nothing was added under its name since that was given up */
        return all;
    for (unsigned writer = 0; all && writer < LWB_MAX_WRITERS; writer++) {
        struct lwb_meta metas[LWB_BUFFERS];
        int found, status = lwb_recent(&self->slot, writer, metas, &found);
        if (status == LWB_RENAMED)
            break;
        if (status) {
            Py_DECREF(all);
            return fail(status, self->name, NULL);
        }
        for (int i = 0; all && i < found; i++) {
            PyObject *one = Py_BuildValue("KKK", (unsigned long long)metas[i].count,
                                          (unsigned long long)metas[i].stamp,
                                          (unsigned long long)metas[i].process);
            if (!one || PyList_Append(all, one))
                Py_CLEAR(all);
            Py_XDECREF(one);
        }
    }
    return all;
}
