/* Error reports: to stderr, and stored for nomad_last_error. */
#include "error.h"

#include "nomad.h"

#include <stdarg.h>
#include <stdio.h>

int nomad_verbose = 1;

static char last[320];

const char *nomad_last_error(void) { return last; }

void nomad_report_error(const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(last, sizeof last, format, arguments);
    va_end(arguments);
    nomad_print("Nclient: %s", last);
}

void nomad_store_error(const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(last, sizeof last, format, arguments);
    va_end(arguments);
}

void nomad_print(const char *format, ...)
{
    va_list arguments;

    if (!nomad_verbose)
        return;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}
