/* What went wrong, on stderr and for nomad_last_error. */
#include "complain.h"

#include "nomad.h"

#include <stdarg.h>
#include <stdio.h>

int nomad_verbose = 1;

static char last[320];

const char *nomad_last_error(void)
{
    return last;
}

void nomad_complain(const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(last, sizeof last, format, arguments);
    va_end(arguments);
    nomad_remark("Nclient: %s", last);
}

void nomad_keep(const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(last, sizeof last, format, arguments);
    va_end(arguments);
}

void nomad_remark(const char *format, ...)
{
    va_list arguments;

    if (!nomad_verbose)
        return;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}
